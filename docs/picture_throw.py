"""Make docs/hand_throw.png, seven pictures of examples/hand_throw.py. Needs what docs/picture.py needs, and CasADi.

python docs/picture_throw.py
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "examples"))

TIMES = 0.0, 0.29, 0.38, 0.47, 0.56, 0.66, 1.0  # [s]: rest, throw, flight, apex, flight, catch, rest
CAMERA = {"eye": (0.26, -0.65, 0.275), "target": (0.005, 0.0, 0.095)}
SIZE = 280, 360  # [pixels] of a picture


def main() -> None:
    from hand_throw import throw

    traj = throw()
    strip = Image.new("RGB", (SIZE[0] * len(TIMES), SIZE[1]))
    with tempfile.TemporaryDirectory() as folder:
        for k, t in enumerate(TIMES):
            file = traj.render(Path(folder) / "throw.png", camera=CAMERA, size=SIZE, at=t, overwrite=True)
            with Image.open(file) as picture:
                strip.paste(picture.convert("RGB"), (SIZE[0] * k, 0))
    # With means of the colours that are near, arrows and points keep theirs, however few pixels they have.
    strip.quantize(255, kmeans=2).save(ROOT / "docs" / "hand_throw.png", optimize=True)


if __name__ == "__main__":
    main()
