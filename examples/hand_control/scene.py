"""The Allegro hand of contactvi.gym, palm up on a wrist that moves, with servos in all 19 joints, and a ball."""

from __future__ import annotations

import numpy as np

import contactvi as cvi
from contactvi.gym.hand import HEIGHT, hand_scene, load_with_ball  # needs contactvi[gym]


def hand(place: tuple[float, float]) -> tuple[cvi.Scene, np.ndarray, np.ndarray]:
    """Return the scene, its start with the ball in the palm at `place` [m], and the targets (19,) that hold it."""
    scene, held, load, stiffness = hand_scene()
    start = np.concatenate([held, place, [HEIGHT, 0.0, 0.0, 0.0, 1.0]])
    return scene, start, held + load_with_ball(load, place) / stiffness
