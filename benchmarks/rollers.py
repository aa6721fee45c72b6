"""Parallel and nearly parallel rollers: where capsules and cylinders touch along lines.

    python benchmarks/rollers.py [--seeds 0:20] [--families pile,vee] [--json FILE] [--limit 60]
    python benchmarks/rollers.py --families vee --show 3      everything about one scene
    python benchmarks/rollers.py --families vee --reduce 3    a smaller scene with the same fault, as a script

Piles in a bin, vees, slopes, pyramids of logs, a capsule on a cylinder, a cylinder on the edge of a box, two that cross
at a small angle. A seed disturbs places and angles a little and chooses the restitution. The families, what is checked
and how a run is judged: benchmarks/faults/checks.py. The time over MuJoCo is that inside the engine (`traj.stats`) with
steps of 1 ms over that of `mj_step` with steps of 2 ms.
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
LIE = np.pi / 2  # about x: the axis of a roller, z, comes to lie along -y
R, LENGTH = 0.05, 0.4  # [m]
ANGLES = (0.0, 0.001, 0.003, 0.01, 0.03, 0.1)  # [rad]
RESTITUTIONS, FRICTIONS, DURATION = (0.0, 0.4, 0.8), (0.0, 0.3, 0.8), 0.5


def roller(
    name: str, x: float, z: float, *, kind: str = "capsule", y: float = 0.0, yaw: float = 0.0, radius: float = R,
    length: float = LENGTH, **rest: object,
) -> Item:  # fmt: skip
    """A roller that lies along y, turned about the vertical by `yaw` [rad]."""
    return Item(kind, name, (radius, length), place=(x, y, z), turn=(LIE, 0.0, yaw), **rest)  # type: ignore[arg-type]


def ground() -> Item:
    return Item("halfspace", "ground", ((0.0, 0.0, 1.0), 0.0))


def small(rng: Random, size: float) -> float:
    """A disturbance, exactly 0 in a third of the cases."""
    return 0.0 if rng.random() < 1 / 3 else float(rng.uniform(-size, size))


def kind_of(rng: Random) -> str:
    return str(rng.choice(["capsule", "cylinder"]))


def walls(half: float) -> list[Item]:
    """A bin along y of fixed boxes, open above and at its ends."""
    size = (0.05, 1.0, 0.6)
    return [
        Item("box", "floor", (2 * half + 0.2, 1.0, 0.05), free=False, place=(0.0, 0.0, -0.025)),
        Item("box", "left", size, free=False, place=(-half - 0.025, 0.0, 0.3)),
        Item("box", "right", size, free=False, place=(half + 0.025, 0.0, 0.3)),
    ]


def pile(rng: Random) -> list[Item]:
    """Rollers fall into a bin, row after row."""
    found, half, kind = walls(0.17), 0.17, kind_of(rng)
    mixed = rng.random() < 0.3
    for k in range(int(rng.integers(3, 9))):
        row, column = divmod(k, 3)
        x = (column - 1) * 0.107 + 0.003 * row * (-1) ** row + small(rng, 3e-3)
        where = {"y": small(rng, 0.01), "yaw": small(rng, 0.01), "kind": kind_of(rng) if mixed else kind}
        found.append(roller(f"r{k}", np.clip(x, -half + 0.052, half - 0.052), 0.06 + 0.105 * row + 1e-3, **where))
    return found


def vee(rng: Random) -> list[Item]:
    """A roller lies in the vee of two fixed parallel ones."""
    a, yaw = 0.06, small(rng, 3e-3)
    height = R + np.sqrt(4 * R * R - a * a)
    fixed = kind_of(rng)
    found = [roller(f"f{k}", x, R, kind=fixed, free=False) for k, x in enumerate((-a, a))]
    return [*found, roller("a", small(rng, 1e-3), height + 1e-3, kind=kind_of(rng), yaw=yaw, y=small(rng, 0.02))]


def slope(rng: Random) -> list[Item]:
    """A roller rolls down a slope onto another one that lies at its foot."""
    angle = float(rng.uniform(0.1, 0.4))
    normal, along = np.array([np.sin(angle), 0.0, np.cos(angle)]), np.array([np.cos(angle), 0.0, -np.sin(angle)])
    low, high = 0.0 * along + (R + 1e-6) * normal, -0.2 * along + (R + 1e-6) * normal
    stop = Item("halfspace", "stop", (tuple((-along).tolist()), -R - 1e-6))
    kind = kind_of(rng)
    return [
        Item("halfspace", "slope", (tuple(normal.tolist()), 0.0)), stop,
        roller("low", low[0], low[2], kind=kind),
        roller("high", high[0], high[2], kind=kind_of(rng), y=small(rng, 0.05), yaw=0.0),
    ]  # fmt: skip


def bin_of(rng: Random) -> list[Item]:
    """Rollers of several radii fall between two halfspaces that form a vee."""
    lean = float(rng.uniform(0.5, 1.0))
    found = [
        Item("halfspace", f"wall{k}", ((s * np.sin(lean), 0.0, np.cos(lean)), 0.0)) for k, s in enumerate((-1.0, 1.0))
    ]
    height = 0.06 / np.cos(lean) + 0.02
    for k in range(int(rng.integers(2, 6))):
        radius = float(rng.uniform(0.02, 0.05))
        height += radius
        found.append(
            roller(f"r{k}", small(rng, 5e-3), height, kind=kind_of(rng), yaw=small(rng, 0.01), radius=radius,
                   mass=float(10 ** rng.uniform(-1, 1)))
        )  # fmt: skip
        height += radius + 2e-3
    return found


def pyramid(rng: Random) -> list[Item]:
    """Logs, three, two and one, between two fixed stops."""
    kind, found = kind_of(rng), [ground()]
    gap = float(rng.choice([0.0, 1e-4]))
    step = 2 * R + gap
    found += [Item("box", f"stop{k}", (0.02, 1.0, 0.06), free=False, place=(s * (step + R + gap + 0.01), 0.0, 0.03))
              for k, s in enumerate((-1, 1))]  # fmt: skip
    for row in range(3):
        height = R + gap + row * (np.sqrt(4 * R * R - 0.25 * step * step) + gap + 1e-12)
        for k in range(3 - row):
            x = (k - 0.5 * (2 - row)) * step
            found.append(roller(f"r{row}{k}", x, height, kind=kind, y=small(rng, 0.01)))
    return found


def on_cylinder(rng: Random) -> list[Item]:
    """A capsule or a cylinder is balanced, or not quite, on a fixed cylinder parallel to it."""
    kind, height = str(rng.choice(["capsule", "cylinder", "capsule"])), float(rng.choice([0.0, 1e-3, 0.05]))
    below = roller("below", 0.0, R, kind="cylinder", free=False, length=float(rng.choice([0.2, 0.4, 0.8])))
    return [ground(), below, roller("a", small(rng, 5e-3), 3 * R + 1e-9 + height, kind=kind, y=small(rng, 0.05))]


def on_edge(rng: Random) -> list[Item]:
    """A cylinder falls on the edge of a fixed box, parallel to it."""
    lean = float(rng.choice([0.0, np.pi / 4, rng.uniform(0.1, 1.4)]))
    edge = 0.1 * (np.cos(lean) + np.sin(lean))
    box = Item("box", "box", (0.2, 0.6, 0.2), free=False, place=(0.0, 0.0, 0.1 * np.sqrt(2)), turn=(0.0, lean, 0.0))
    x = 0.1 * (np.sin(lean) - np.cos(lean)) if lean else 0.1
    z = 0.1 * np.sqrt(2) + edge + R + float(rng.choice([1e-6, 1e-2]))
    return [ground(), box, roller("a", x + small(rng, 5e-3), z, kind=kind_of(rng), y=small(rng, 0.05))]


def crossed(rng: Random, angle: float) -> list[Item]:
    """Two rollers on each other on the ground, or on two fixed ones, turned against each other by an angle."""
    x = small(rng, 2e-3)
    if rng.random() < 0.5:
        found = [ground(), roller("low", 0.0, R + 1e-9, kind=kind_of(rng))]
        found += [roller(f"side{k}", s * 2 * (R + 1e-6), R + 1e-9, kind=kind_of(rng)) for k, s in enumerate((-1, 1))]
        z = R + np.sqrt(3) * R if rng.random() < 0.5 else 3 * R
        x += R if z < 3 * R else 0.0
        return [*found, roller("top", x, max(z, R + 1e-3) + 2e-3, kind=kind_of(rng), yaw=angle)]
    found = [roller(f"f{k}", s * 0.04, R, kind=kind_of(rng), free=False) for k, s in enumerate((-1, 1))]
    return [*found, roller("top", x, 2.9 * R + 2e-3, kind=kind_of(rng), yaw=angle, y=small(rng, 0.02))]


FAMILIES: dict[str, Callable[[Random], list[Item]]] = {
    "pile": pile, "vee": vee, "slope": slope, "bin": bin_of, "pyramid": pyramid, "on_cylinder": on_cylinder,
    "on_edge": on_edge,
    **{f"crossed_{angle:g}": (lambda rng, a=angle: crossed(rng, a)) for angle in ANGLES},
}  # fmt: skip


def make(family: str, seed: int) -> Recipe:
    """Return the scene of a family and a seed."""
    rng = np.random.default_rng([sum(map(ord, family)), seed])
    e = RESTITUTIONS[seed % 3]
    friction = float(rng.choice(FRICTIONS))
    items = tuple(plain(item) for item in FAMILIES[family](rng))
    return freed(Recipe(family, seed, items, e, friction, DURATION))


def plain(item: Item) -> Item:
    """The same with Python's numbers."""
    return replace(item, place=tuple(map(float, item.place)), turn=tuple(map(float, item.turn)))


if __name__ == "__main__":
    sys.exit(main(__doc__, FAMILIES, make, 20))
