"""A ball on a string, with a spring along a line through three points: what a playback draws as lines."""

from __future__ import annotations

import contactvi as cvi


def hung_ball() -> cvi.Trajectory:
    """One second of it: the string hangs from (0, 0, 1), the spring goes from (-1, 0, 0) by way of (-0.5, 0, 0.5).

    The length of the string is a function of time, which files do not store.
    """
    scene = cvi.Scene()
    scene.add_sphere("ball", radius=0.05, mass=1.0, placement=(0.6, 0.0, 0.2))
    scene.add_distance("world", "ball", (0, 0, 1), length=lambda t: (1.0, 0.0, 0.0), name="string")
    scene.add_tape_spring(
        [("world", (-1, 0, 0)), ("world", (-0.5, 0, 0.5)), ("ball", (0, 0, 0))], 5.0, rest_length=1.0, name="tape"
    )
    return cvi.simulate(scene, duration=1.0, dt=1e-3)
