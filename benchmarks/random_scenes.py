"""Random scenes of mixed bodies on floors of all kinds: runs that are wrong and do not say so, and slow ones.

    python benchmarks/random_scenes.py [--seeds 0:25] [--families free,bars] [--json FILE] [--limit 60]
    python benchmarks/random_scenes.py --families bars --show 3      everything about one scene
    python benchmarks/random_scenes.py --families bars --reduce 3    a smaller scene with the same fault, as a script

Spheres, boxes, capsules, cylinders, hulls of random points, prisms, wedges and chains of links, with masses over three
decades, thrown on slopes, on fixed bars and wedges, or standing on each other. What is checked and how a run is judged:
benchmarks/faults/checks.py. The time over MuJoCo is that inside the engine (`traj.stats`) with steps of 1 ms over that
of `mj_step` with steps of 2 ms.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent / "faults"))
from finder import main
from recipes import Item, Recipe, freed

Random = np.random.Generator
RESTITUTIONS, FRICTIONS, DURATION = (0.0, 0.0, 0.3, 0.5, 0.8, 1.0), (0.0, 0.3, 0.8, 1.5), 0.6
KINDS = ("sphere", "box", "capsule", "cylinder", "mesh")
UP, ROOM = (0.0, 0.0, 1.0), 0.25  # [m] half the width of the place where bodies fall


def numbers(values: object) -> tuple[float, ...]:
    return tuple(float(x) for x in np.ravel(values))  # type: ignore[call-overload]


def turned(rng: Random) -> tuple[float, ...]:
    """Roll, pitch and yaw: any, or one of those in which faces and axes are parallel."""
    if rng.random() < 0.3:
        return numbers(rng.choice([0.0, np.pi / 2], 2)) + (float(rng.choice([0.0, np.pi / 2, rng.uniform(-3, 3)])),)
    return numbers(rng.uniform(-np.pi, np.pi, 3))


def vertices(rng: Random, size: float) -> list[list[float]]:
    """Random points, a prism of 3 to 8 sides, or a wedge, in a box of edges 2 size, about their centre."""
    choice = rng.integers(3)
    if choice == 0:
        points = rng.uniform(-size, size, (int(rng.integers(6, 20)), 3))
    elif choice == 1:
        angle = 2 * np.pi * np.arange(count := int(rng.integers(3, 9))) / count
        ring = size * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])
        points = np.vstack([ring - [0, 0, 0.6 * size], ring + [0, 0, 0.6 * size]])
    else:
        points = wedge(2 * size, 2 * size, float(rng.uniform(0.3, 2.0)) * size)
        points = points - points.mean(axis=0)
    return np.round(points, 6).tolist()


def wedge(length: float, width: float, height: float) -> np.ndarray:
    """The corners of a wedge that rises along x from 0 to its height."""
    profile = np.array([[-length / 2, 0.0], [length / 2, 0.0], [length / 2, height]])
    return np.array([[x, y, z] for y in (-width / 2, width / 2) for x, z in profile])


def sizes(rng: Random, kind: str) -> object:
    a = rng.uniform(0.03, 0.1, 3)
    return {
        "sphere": float(a[0]), "box": numbers(2 * a), "capsule": (0.6 * float(a[0]), 2 * float(a[1])),
        "cylinder": (float(a[0]), 2 * float(a[1])), "mesh": None,
    }[kind] or vertices(rng, float(a[0]))  # fmt: skip


def bodies(rng: Random, count: int, kinds: tuple[str, ...] = KINDS, fast: float = 1.0) -> list[Item]:
    """Bodies in the air, some of which move."""
    found = []
    for k in range(count):
        kind = str(rng.choice(kinds))
        moves = fast * float(rng.choice([0.0, 1.0, 3.0]))
        found.append(
            Item(
                kind, f"{kind}{k}", sizes(rng, kind), mass=float(10 ** rng.uniform(-1.5, 1.5)),
                place=(*numbers(rng.uniform(-0.6 * ROOM, 0.6 * ROOM, 2)), float(rng.uniform(0.1, 0.3))),
                turn=turned(rng), velocity=numbers(rng.normal(size=3) * 0.3 * moves),
                spin=numbers(rng.normal(size=3) * 2 * moves),
            )
        )  # fmt: skip
    return found


def room(rng: Random) -> list[Item]:
    """The ground, or slopes that form a valley, so that bodies meet."""
    lean = float(rng.choice([0.0, rng.uniform(0.05, 0.6)]))
    if lean == 0.0:
        return [Item("halfspace", "ground", (UP, 0.0))]
    count, turn = int(rng.integers(1, 4)), float(rng.uniform(0, 2 * np.pi))
    angles = turn + 2 * np.pi * np.arange(count) / count
    normals = [(float(np.sin(lean) * np.cos(a)), float(np.sin(lean) * np.sin(a)), float(np.cos(lean))) for a in angles]
    return [Item("halfspace", f"slope{k}", (normal, -0.05)) for k, normal in enumerate(normals)]


def free(rng: Random) -> list[Item]:
    """Bodies of all kinds are thrown on the ground, on a slope or into a valley."""
    return room(rng) + bodies(rng, int(rng.integers(2, 9)))


def pairs(rng: Random) -> list[Item]:
    """Two or three bodies of few kinds, one above the other, spin and fall."""
    kinds = ("cylinder", "box", "capsule", "mesh")[: int(rng.integers(1, 5))]
    found = [Item("halfspace", "ground", (UP, 0.0))]
    for k, item in enumerate(bodies(rng, int(rng.integers(2, 4)), kinds, fast=2.0)):
        found.append(replace(item, place=(0.02 * k, 0.01 * k, 0.2 + 0.3 * k)))
    return found


def bars(rng: Random) -> list[Item]:
    """Bodies fall on fixed bars, parallel, crossed or nearly so."""
    found, layers = [], int(rng.integers(1, 3))
    for layer in range(layers):
        kind, yaw = (
            str(rng.choice(["cylinder", "box", "capsule"])),
            float(rng.choice([0.0, np.pi / 2, rng.uniform(-3, 3)])),
        )
        spacing = float(rng.uniform(0.06, 0.14))
        for k in range(-3, 4):
            x, y = spacing * k * np.cos(yaw), spacing * k * np.sin(yaw)
            where = {"place": (float(x), float(y), -0.05 * layer), "free": False}
            if kind == "box":
                item = Item(
                    kind,
                    f"bar{layer}{k + 3}",
                    (0.03, 1.2, 0.03),
                    turn=(0.0, float(rng.choice([0.0, 0.7])), yaw),
                    **where,
                )
            else:
                item = Item(kind, f"bar{layer}{k + 3}", (0.02, 1.2), turn=(np.pi / 2, 0.0, yaw), **where)
            found.append(item)
    return found + bodies(rng, int(rng.integers(1, 6)))


def stacks(rng: Random) -> list[Item]:
    """Boxes, cylinders, prisms and spheres stand on each other, with gaps of 0, 1 um or 1 mm."""
    found, height, gap = [Item("halfspace", "ground", (UP, 0.0))], 0.0, float(rng.choice([0.0, 1e-6, 1e-3]))
    for k in range(int(rng.integers(2, 7))):
        kind = str(rng.choice(["box", "cylinder", "mesh", "box", "cylinder", "lying", "sphere"]))
        name, mass, yaw = (
            f"{kind}{k}",
            float(10 ** rng.uniform(-1.5, 1.5)),
            float(rng.choice([0.0, rng.uniform(-3, 3)])),
        )
        turn = (0.0, 0.0, yaw)
        if kind == "mesh":
            count, half = int(rng.integers(3, 9)), float(rng.uniform(0.02, 0.06))
            angle = 2 * np.pi * np.arange(count) / count
            ring = 0.1 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])
            size: object = np.vstack([ring - [0, 0, half], ring + [0, 0, half]]).tolist()
        elif kind == "lying":
            kind, size, turn = (
                str(rng.choice(["cylinder", "capsule"])),
                (half := float(rng.uniform(0.03, 0.06)), 0.2),
                (np.pi / 2, 0.0, yaw),
            )
        else:
            size = sizes(rng, kind)
            half = {"box": lambda s: s[2] / 2, "cylinder": lambda s: s[1] / 2, "sphere": lambda s: s}[kind](size)
        place = (*numbers(rng.choice([0.0, 0.01]) * rng.uniform(-1, 1, 2)), height + gap + half)
        found.append(Item(kind, name, size, mass=mass, place=place, turn=turn))
        height += gap + 2 * half
    return found


def wedges(rng: Random) -> list[Item]:
    """Fixed wedges and prisms as a floor, on which bodies slide down."""
    found = [Item("halfspace", "ground", (UP, 0.0))]
    for k in range(int(rng.integers(1, 4))):
        points = np.round(wedge(float(rng.uniform(0.2, 0.5)), 0.4, float(rng.uniform(0.05, 0.2))), 6).tolist()
        place = (*numbers(rng.uniform(-0.15, 0.15, 2)), float(rng.choice([0.0, 0.0, 0.01])))
        found.append(
            Item("mesh", f"wedge{k}", points, free=False, place=place, turn=(0.0, 0.0, float(rng.uniform(-3, 3))))
        )
    return found + bodies(rng, int(rng.integers(1, 6)))


def rods(rng: Random) -> list[Item]:
    """Capsules and cylinders alone, lying along few directions."""
    found = room(rng)
    for k in range(int(rng.integers(2, 8))):
        kind = str(rng.choice(["capsule", "cylinder"]))
        yaw = float(rng.choice([0.0, 0.0, 1e-3, np.pi / 2, rng.uniform(-3, 3)]))
        place = (*numbers(rng.uniform(-0.05, 0.05, 2)), 0.1)
        found.append(
            Item(kind, f"{kind}{k}", (float(rng.choice([0.03, 0.04])), 0.3), mass=float(10 ** rng.uniform(-1, 1)),
                 place=place, turn=(np.pi / 2, 0.0, yaw))
        )  # fmt: skip
    return found


def chains(rng: Random) -> list[Item]:
    """A chain of two or three links, held by its base or thrown, among bodies."""
    found, held = room(rng), bool(rng.random() < 0.6)
    count = int(rng.integers(2, 4))
    text = chain_text(rng, count, held)
    joints = {f"hinge{k}": (float(rng.uniform(-1.0, 1.0)), float(rng.normal())) for k in range(not held, count)}
    place = (0.0, 0.0, float(rng.uniform(0.3, 0.5)))
    # A held chain comes first, so that the bodies make way for it.
    chain = Item(
        "urdf", "chain", text, free=not held, place=place, turn=(0.0, 0.0, float(rng.uniform(-3, 3))), joints=joints
    )
    return [*found, chain, *bodies(rng, int(rng.integers(1, 5)))]


def chain_text(rng: Random, count: int, held: bool) -> str:
    """A URDF of links that hang from each other by revolute joints with limits; the base is a frame or a link."""
    lines, length = ['<robot name="chain">', '<link name="base"/>' if held else ""], 0.15
    for k in range(count):
        mass, r = float(10 ** rng.uniform(-1, 1)), float(rng.uniform(0.015, 0.03))
        shape = str(
            rng.choice(
                [
                    f'<box size="{2 * r} {2 * r} {length - 3 * r}"/>',
                    f'<cylinder radius="{r}" length="{length - 3 * r}"/>',
                    f'<sphere radius="{1.5 * r}"/>',
                ]
            )
        )
        about = mass * length**2 / 10
        origin = f'<origin xyz="0 0 {-length / 2}"/>'
        lines.append(
            f'<link name="link{k}"><inertial>{origin}<mass value="{mass}"/><inertia ixx="{about}" iyy="{about}"'
            f' izz="{0.5 * about}" ixy="0" ixz="0" iyz="0"/></inertial><collision>{origin}<geometry>{shape}</geometry>'
            "</collision></link>"
        )
        if not k and not held:
            continue
        parent = f"link{k - 1}" if k else "base"
        axis = str(rng.choice(["1 0 0", "0 1 0", "0.6 0.8 0"]))
        lines.append(
            f'<joint name="hinge{k}" type="revolute"><parent link="{parent}"/><child link="link{k}"/><origin xyz="0 0'
            f' {-length if k else 0.0}"/><axis xyz="{axis}"/><limit lower="-1.2" upper="1.2" effort="0" velocity="0"/>'
            "</joint>"
        )
    return "\n".join([*lines, "</robot>"])


def mixed(rng: Random) -> list[Item]:
    """Two of these floors and all kinds of bodies."""
    one = [item for item in (bars(rng) if rng.random() < 0.5 else wedges(rng)) if not item.moves]
    chain = [item for item in chains(rng) if item.shape == "urdf"] if rng.random() < 0.3 else []
    chain = [replace(item, place=(0.0, 0.0, 0.8)) for item in chain]  # held above the floor, whatever its angles
    return [*one, *chain, *bodies(rng, int(rng.integers(2, 7)))]


FAMILIES: dict[str, Callable[[Random], list[Item]]] = {
    "free": free,
    "pairs": pairs, "bars": bars, "stacks": stacks, "wedges": wedges, "rods": rods, "chains": chains, "mixed": mixed,
}  # fmt: skip


def make(family: str, seed: int) -> Recipe:
    """Return the scene of a family and a seed."""
    rng = np.random.default_rng([sum(map(ord, family)), seed])
    e, friction = float(rng.choice(RESTITUTIONS)), float(rng.choice(FRICTIONS))
    return freed(Recipe(family, seed, tuple(FAMILIES[family](rng)), e, friction, DURATION))


if __name__ == "__main__":
    sys.exit(main(__doc__, FAMILIES, make, 25))
