"""The woodpecker toy of Glocker as a model of slides, with exactly its linear equations.

Glocker, Pfeiffer, "Multiple impacts with friction in rigid multibody systems", Nonlinear Dynamics 7 (1995); Glocker,
Studer (2005). Their equations are linear in the angles of sleeve and bird. Here the angles are lengths of vertical
slides, sleeve l_M phi_M and bird l_G phi_S, with the inertias as armature; the touching points follow them, vertically
and horizontally, as joints that are coupled to the slides.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from contactvi.scene.scene import Scene

# Lengths [m], masses [kg], inertias [kg m^2], spring [N m/rad] of sleeve (M), bird (S) and pole.
R0, RM, HM, LM, LG, HS, LS = 0.0025, 0.0031, 0.0058, 0.010, 0.015, 0.020, 0.0201
MASS_M, MASS_S, J_M, J_S, SPRING, GRAVITY, MU = 3e-4, 4.5e-3, 5e-9, 7e-7, 0.0056, 9.81, 0.3
POINT = 1e-8  # [m] radius of the balls that stand for points
ARM = 0.01  # [m] lever of the torsion spring

SLIDE = """<joint name="{name}" type="prismatic"><parent link="{parent}"/><child link="{child}"/><origin xyz="{x} 0 0"/>
<axis xyz="{axis}"/><limit lower="-9" upper="9" effort="1" velocity="1"/>{mimic}</joint>"""
MASS = '<inertial><mass value="{m}"/><inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial>'
BALL = f'<collision><geometry><sphere radius="{POINT}"/></geometry></collision>'


def urdf() -> str:
    """Return the model: three slides in a row, and the points that follow them."""
    parts = ['<robot name="woodpecker"><link name="base"/>']

    def link(name: str, inside: str = "") -> None:
        parts.append(f'<link name="{name}">{inside}</link>')

    def slide(name: str, parent: str, child: str, axis: str = "0 0 1", x: float = 0.0, follows: str = "") -> None:
        mimic = f'<mimic joint="{follows.split()[0]}" multiplier="{follows.split()[1]}"/>' if follows else ""
        parts.append(SLIDE.format(name=name, parent=parent, child=child, axis=axis, x=repr(x), mimic=mimic))

    def point(name: str, parent: str, x: float, joint: str, across: float, up: float) -> None:
        link(f"{name}_x")
        link(name, BALL)
        slide(f"{name}_x", parent, f"{name}_x", "1 0 0", x, f"{joint} {across!r}")
        slide(f"{name}_z", f"{name}_x", name, "0 0 1", 0.0, f"{joint} {up!r}")

    link("sleeve", MASS.format(m=MASS_M, i=1e-9))
    link("hinge")
    link("bird", MASS.format(m=MASS_S, i=1e-9))
    slide("y", "base", "sleeve")
    slide("s_M", "sleeve", "hinge")
    slide("s_S", "hinge", "bird")
    point("lower", "sleeve", RM, "s_M", HM / LM, RM / LM)
    point("upper", "sleeve", RM, "s_M", -HM / LM, RM / LM)
    point("beak", "hinge", LM + LG - LS, "s_S", -HS / LG, (LG - LS) / LG)
    for name, x, joint, length in (("spring_M", 1.0, "s_M", LM), ("spring_S", 2.0, "s_S", LG)):
        link(name)
        slide(name, "base", name, "1 0 0", x, f"{joint} {ARM / length!r}")
    return "\n".join([*parts, "</robot>"])


def woodpecker(folder: Path, e: float = 0.5) -> Scene:
    """Return the toy at its pole."""
    file = folder / "woodpecker.urdf"
    file.write_text(urdf())
    made = Scene(gravity=(0.0, 0.0, -GRAVITY))
    inertias = {"s_M": J_M / LM**2, "s_S": J_S / LG**2}
    made.add_urdf(file, limits=False, self_collision=False, armature=inertias)
    pole = made.add_halfspace((1.0, 0.0, 0.0), R0 - POINT, name="pole")
    made.add_spring("spring_M", "spring_S", stiffness=SPRING / ARM**2, rest_length=1.0)
    made.set_contact(friction=MU, restitution=0.0, restitution_law="newton")
    made.set_contact("beak", pole, restitution=e)
    return made


def start(made: Scene, q: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return q and v of the oracle's state."""
    scale = np.array([1.0, LM, LG])
    names = ("y", "s_M", "s_S")
    follow = {"lower_x": (1, HM / LM), "lower_z": (1, RM / LM), "upper_x": (1, -HM / LM)}
    follow |= {"upper_z": (1, RM / LM), "beak_x": (2, -HS / LG)}
    follow |= {"beak_z": (2, (LG - LS) / LG), "spring_M": (1, ARM / LM), "spring_S": (2, ARM / LG)}

    def values(x: np.ndarray) -> dict[str, float]:
        moved = scale * x
        return dict(zip(names, moved, strict=True)) | {name: moved[k] * by for name, (k, by) in follow.items()}

    return made.configuration(values(q)), made.velocity(values(u))
