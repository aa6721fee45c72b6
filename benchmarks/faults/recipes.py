"""A scene as plain data: what is needed to build it, to take parts of it away, and to print it as a script."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import contactvi as cvi

Array = np.ndarray


@dataclass(frozen=True)
class Item:
    """A body, a halfspace or a chain of links.

    Attributes:
        shape: "sphere", "box", "capsule", "cylinder", "mesh", "halfspace" or "urdf".
        size: what the scene's method takes: radius; edge lengths; radius and length; vertices; normal and offset; of a
            chain the text of its URDF.
        mass: [kg]. free: moves, else fixed to the world; of a chain its base.
        place, turn: xyz [m] and roll pitch yaw [rad].
        velocity, spin: at the start, world axes [m/s], [rad/s].
        joints: angles and rates of the joints of a chain at the start, by name.
    """

    shape: str
    name: str
    size: Any
    mass: float = 1.0
    free: bool = True
    place: tuple[float, ...] = (0.0, 0.0, 0.0)
    turn: tuple[float, ...] = (0.0, 0.0, 0.0)
    velocity: tuple[float, ...] = (0.0, 0.0, 0.0)
    spin: tuple[float, ...] = (0.0, 0.0, 0.0)
    joints: dict[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def moves(self) -> bool:
        """Whether it has a free joint."""
        return self.free and self.shape != "halfspace"

    @property
    def arguments(self) -> str:
        """The call that adds it to a scene, as text."""
        place = f"placement=({_text(self.place)}, {_text(self.turn)})"
        if self.shape == "halfspace":
            return f"add_halfspace({_text(self.size[0])}, {self.size[1]!r}, name={self.name!r})"
        if self.shape == "urdf":
            return f"add_urdf(FILE, base={'free' if self.free else 'fixed'!r}, {place})"
        sizes = {"sphere": "{!r}", "capsule": "{!r}, {!r}", "cylinder": "{!r}, {!r}"}.get(self.shape)
        size = _text(self.size) if sizes is None else sizes.format(*map(float, np.atleast_1d(self.size)))
        weight = f"mass={self.mass!r}" if self.free else "free=False"
        return f"add_{self.shape}({self.name!r}, {size}, {weight}, {place})"


@dataclass(frozen=True)
class Recipe:
    """A scene, its start and its duration [s]; one restitution and one friction for all contacts."""

    family: str
    seed: int
    items: tuple[Item, ...]
    restitution: float
    friction: float
    duration: float

    def build(self) -> tuple[cvi.Scene, Array, Array]:
        """Return the scene and its start (nq,), (nv,)."""
        scene, moving, joints, rates = cvi.Scene(), {}, {}, {}
        for item in self.items:
            handle = add(scene, item)
            if item.moves and (any(item.velocity) or any(item.spin)):
                moving[handle] = (np.array(item.velocity), np.array(item.spin))
            joints |= {name: value[0] for name, value in item.joints.items()}
            rates |= {name: value[1] for name, value in item.joints.items()}
        scene.set_contact(restitution=self.restitution, friction=self.friction)
        return scene, scene.configuration(joints), scene.velocity(moving | rates)

    def less(self, names: set[str]) -> Recipe:
        """Return it without some items."""
        return replace(self, items=tuple(item for item in self.items if item.name not in names))

    def script(self) -> str:
        """Return a script that runs it and prints the least gap and the largest rise of the energy in a step."""
        lines = ["import tempfile, warnings", "from pathlib import Path", "", "import numpy as np", ""]
        lines += ["import contactvi as cvi", "", 'warnings.simplefilter("ignore")', "s = cvi.Scene()"]
        moving, joints, rates = [], [], []
        for item in self.items:
            if item.shape == "urdf":
                lines.append('FILE = Path(tempfile.mkdtemp()) / "chain.urdf"')
                lines.append(f'FILE.write_text("""{item.size}""")')
            lines.append(f"s.{item.arguments}")
            if item.moves and (any(item.velocity) or any(item.spin)):
                moving.append(f"{item.name!r}: ({_text(item.velocity)}, {_text(item.spin)})")
            joints += [f"{name!r}: {value[0]!r}" for name, value in item.joints.items()]
            rates += [f"{name!r}: {value[1]!r}" for name, value in item.joints.items()]
        lines.append(f"s.set_contact(restitution={self.restitution!r}, friction={self.friction!r})")
        lines.append(f"q0, v0 = s.configuration({{{', '.join(joints)}}}), s.velocity({{{', '.join(moving + rates)}}})")
        lines.append(f"tr = cvi.simulate(s, q0, v0, {self.duration!r}, dt=1e-3, throw=False)")
        lines.append("gaps, names = np.array([s.gaps(q) for q in tr.q]), s.gap_names")
        lines.append("k, pair = np.unravel_index(gaps.argmin(), gaps.shape)")
        lines.append("rise = np.diff(tr.energy)")
        lines.append('print(tr.status, f"{tr.stats.seconds:.2f} s, {tr.stats.dense_steps} dense steps")')
        lines.append('print(f"least gap {gaps[k, pair]:.3g} m at {tr.t[k]:.4f} s, {names[pair]}")')
        lines.append(
            'print(f"largest rise of the energy in a step {rise.max():.3g} J at {tr.t[1:][rise.argmax()]:.4f} s,"'
        )
        lines.append('      f" of {tr.kinetic_energy.max():.3g} J")')
        return "\n".join(lines) + "\n"


def freed(recipe: Recipe, margin: float = 0.0) -> Recipe:
    """Return it with every free body lifted, one after the other, until it is apart from what stands before it."""
    scene, q, _ = recipe.build()
    names, done, lifted = scene.gap_names, [], []
    for item in recipe.items:
        done.append(item.name)
        at = scene.q_index(item.name).start + 2 if item.moves else 0
        pairs = [
            k for k, pair in enumerate(names) if item.name in map(_owner, pair) and set(map(_owner, pair)) <= set(done)
        ]
        for _ in range(400):
            least = scene.gaps(q)[pairs].min() if item.moves and pairs else np.inf
            if least >= margin:
                break
            q[at] += max(margin - least, 1e-6) + 1e-4
        height = float(q[at]) if item.moves else item.place[2]
        lifted.append(replace(item, place=(*item.place[:2], height)))
    return replace(recipe, items=tuple(lifted))


def _owner(name: str) -> str:
    """The name of the item that has a shape; the links of a chain are called link0, link1, ..."""
    return "chain" if name.startswith("link") else name


def add(scene: cvi.Scene, item: Item) -> Any:
    """Add an item to a scene and return its handle."""
    where = (item.place, item.turn)
    if item.shape == "halfspace":
        return scene.add_halfspace(item.size[0], item.size[1], name=item.name)
    if item.shape == "urdf":
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "chain.urdf"
            file.write_text(item.size)
            return scene.add_urdf(file, base="free" if item.free else "fixed", placement=where)
    sizes = (item.size,) if item.shape in ("box", "mesh") else tuple(np.atleast_1d(item.size).tolist())
    weight: dict[str, Any] = {"mass": item.mass} if item.free else {"free": False}
    return getattr(scene, f"add_{item.shape}")(item.name, *sizes, placement=where, **weight)


def _text(numbers: Any) -> str:
    """Return nested numbers as text that reads back to the same."""
    if np.ndim(numbers) == 0:
        return repr(float(numbers))
    inner = ", ".join(_text(x) for x in numbers)
    return f"[{inner}]" if np.ndim(numbers) == 2 else f"({inner})"
