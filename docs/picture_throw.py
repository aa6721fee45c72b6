"""Make docs/hand_throw.png, seven pictures of examples/hand_throw.py. Needs what docs/picture.py needs.

python docs/picture_throw.py
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import picture
from PIL import Image

TIMES = 0.0, 0.29, 0.38, 0.466, 0.56, 0.66, 1.1  # [s]: rest, throw, flight, apex, flight, catch, rest
LEFT, WIDTH = 100, 280  # of what is kept of a picture [pixels]
TARGET, SIDE, DISTANCE, OPENING = (0.0, 0.0, 0.09), np.array([0.35, -0.9, 0.25]), 1.5, 14.0  # of the camera


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "throw.html"
        subprocess.run([sys.executable, str(picture.ROOT / "examples" / "hand_throw.py"), str(page)], check=True)
        browser = picture.start(folder)
        try:
            browser.get(page.as_uri())
            side = (SIDE / np.linalg.norm(SIDE)).tolist()
            size = [2 * pixels for pixels in picture.SIZE]
            browser.execute_script(picture.CAMERA, TARGET, side, DISTANCE, OPENING, *size)
            frames = [picture.picture(browser, t).crop((LEFT, 0, LEFT + WIDTH, picture.SIZE[1])) for t in TIMES]
        finally:
            browser.quit()
    strip = Image.new("RGB", (WIDTH * len(frames), picture.SIZE[1]))
    for k, frame in enumerate(frames):
        strip.paste(frame, (WIDTH * k, 0))
    strip.quantize(128).save(picture.ROOT / "docs" / "hand_throw.png", optimize=True)


if __name__ == "__main__":
    main()
