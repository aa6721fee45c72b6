"""Scenes of tests/oracles/switching.py for the engine: a ball on ropes, a pendulum with a servo."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import contactvi as cvi
from oracles.switching import Rope

Array = NDArray[np.float64]

RADIUS = 0.05
MASS = 0.8
LINK = 1.0  # [m] from the joint to the centre of the rod of `pendulum`, which has 1 kg
ABOUT_CENTRE = 0.01  # [kg m^2]
INERTIA = ABOUT_CENTRE + LINK**2


def ball_on_ropes(x: Array, ropes: list[Rope], restitution: float | None = None) -> cvi.Scene:
    """A ball at x on ropes, above a ground where it has a restitution."""
    scene = cvi.Scene()
    if restitution is not None:
        scene.add_halfspace()
    scene.add_sphere("bob", RADIUS, MASS, placement=tuple(x))
    for k, rope in enumerate(ropes):
        scene.add_spring(
            "world", "bob", rope.stiffness, rest_length=rope.rest, damping=rope.damping,
            point_a=tuple(rope.anchor), tension_only=True, name=f"rope{k}",
        )  # fmt: skip
    if restitution is not None:
        scene.set_contact(restitution=restitution, friction=0.0)
    return scene


def at_speed(scene: cvi.Scene, v: Array) -> Array:
    """The velocity of `ball_on_ropes` with the ball at a speed v."""
    return scene.velocity({"bob": tuple(v)})


def pendulum(folder: Path, effort: float = 1e3, speed: float = 1e3) -> cvi.Scene:
    """A rod that hangs at q = 0, with the limits of effort and speed of its file."""
    path = folder / "pendulum.urdf"
    i = ABOUT_CENTRE
    path.write_text(f"""<robot name="p"><link name="base"/><link name="rod"><inertial><origin xyz="0 0 -{LINK}"/>
<mass value="1"/><inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 -1 0"/>
<limit lower="-9" upper="9" effort="{effort}" velocity="{speed}"/></joint></robot>""")
    scene = cvi.Scene()
    scene.add_urdf(path, limits=False)
    return scene
