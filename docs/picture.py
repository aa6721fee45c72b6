"""Make the README's picture, docs/hand_and_ball.gif and .png: a ball falls into the Allegro hand.

    python docs/picture.py

Runs models/allegro_ball.toml and draws it (`Trajectory.render`). Needs Chromium (Debian: chromium).
"""

from __future__ import annotations

from pathlib import Path

import contactvi as cvi

ROOT = Path(__file__).resolve().parents[1]
CAMERA = {"eye": (-0.13, 0.32, 0.27), "target": (0.015, 0.0, 0.05)}
SIZE = 480, 360  # [pixels]
SHOWN = 0.1, 1.1  # [s] of the run: from when the ball comes into view until it is nearly at rest
SPEED = 0.4  # simulated seconds per second
STILL = 0.45  # [s] time of the picture that stands


def main() -> None:
    traj = cvi.simulate(cvi.load_scene(ROOT / "models" / "allegro_ball.toml"), duration=SHOWN[1])
    target, (start, end) = ROOT / "docs" / "hand_and_ball", SHOWN
    traj.render(target.with_suffix(".png"), camera=CAMERA, size=SIZE, at=STILL, speed=SPEED, overwrite=True)
    traj.render(
        target.with_suffix(".gif"),
        camera=CAMERA,
        size=SIZE,
        start=start,
        end=end,
        speed=SPEED,
        overwrite=True,
        fps=16.0,
    )


if __name__ == "__main__":
    main()
