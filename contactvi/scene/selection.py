"""Names in a scene: handles, and the selection of joints, bodies and geometries by name, pattern or handle."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import pinocchio as pin

from contactvi.errors import InputError, did_you_mean
from contactvi.importing.joint_kinds import joint_kind
from contactvi.importing.mjcf.actuators import Actuator
from contactvi.inputs import short

_PATTERN = ("*", "?", "[")


@dataclass(frozen=True)
class PartHandle:
    """An added model: names of its joints, bodies and collision geometries, with the prefix; actuators of an MJCF."""

    name: str
    joints: tuple[str, ...] = ()
    bodies: tuple[str, ...] = ()
    geometries: tuple[str, ...] = ()
    actuators: tuple[Actuator, ...] = ()

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class BodyHandle(PartHandle):
    """A single body: a primitive or a halfspace."""

    @property
    def joint(self) -> str | None:
        """Name of its free joint, None when it is fixed to the world."""
        return self.joints[0] if self.joints else None


Selector = str | PartHandle


class Names:
    """The names of an assembled scene, by which selectors are resolved.

    A selector is a handle, the name of a part, a body, a geometry or a joint (the first kind that has it), or a
    pattern with * ? [] over these names.
    """

    def __init__(
        self, model: pin.Model, collision: pin.GeometryModel, parts: Mapping[str, PartHandle] | None = None
    ) -> None:
        self.parts = dict(parts or {})
        self.joints = list(model.names)[1:]
        self._base: dict[str, str | None] = {}  # of each joint, the free joint at the root on which it hangs
        for name, joint, parent in list(zip(model.names, model.joints, model.parents, strict=True))[1:]:
            free = name if joint_kind(joint) == "free" else None
            self._base[name] = self._base[model.names[parent]] if parent else free
        self.bodies: dict[str, list[int]] = {}
        self.by_joint: dict[str, list[int]] = {name: [] for name in self.joints}
        for frame in model.frames:
            if frame.type == pin.FrameType.BODY:
                self.bodies[frame.name] = []
        self.geometries: dict[str, int] = {}
        for index, geometry in enumerate(collision.geometryObjects):
            self.geometries[geometry.name] = index
            self.bodies.setdefault(model.frames[geometry.parentFrame].name, []).append(index)
            if geometry.parentJoint:
                self.by_joint[model.names[geometry.parentJoint]].append(index)

    @property
    def shape_groups(self) -> dict[str, tuple[str, ...]]:
        """The names of the collision geometries of every part and body; a part comes before a body of its name."""
        names = list(self.geometries)
        bodies = {body: tuple(names[k] for k in indices) for body, indices in self.bodies.items()}
        return bodies | {part: handle.geometries for part, handle in self.parts.items()}

    def select_geometries(self, selector: Selector, argument: str) -> list[int]:
        """Return the indices of the selected collision geometries.

        Raises:
            InputError: unknown name, or a body without collision geometry.
        """
        found = self._geometries(selector)
        if found is None:
            known = [*self.parts, *self.bodies, *self.geometries, *self.joints]
            raise InputError(
                f"Unknown {argument}",
                name=argument,
                expected="a handle, or the name of a part, body, geometry or joint",
                got=short(selector if isinstance(selector, str) else getattr(selector, "name", selector)),
                remedy=did_you_mean(_called(selector), dict.fromkeys(known)),
            )
        if not found:
            raise InputError(
                f"{_called(selector)!r} has no collision geometry",
                name=argument,
                expected="a body with a shape",
                got="none",
                remedy="Name a body with a shape, or add a shape to its model",
            )
        return found

    def _geometries(self, selector: Selector) -> list[int] | None:
        if isinstance(selector, PartHandle):
            if not all(name in self.geometries for name in selector.geometries):
                return None
            return [self.geometries[name] for name in selector.geometries]
        if not isinstance(selector, str):
            return None
        if selector in self.parts:
            return [self.geometries[name] for name in self.parts[selector].geometries]
        if selector in self.bodies:
            return list(self.bodies[selector])
        if selector in self.geometries:
            return [self.geometries[selector]]
        if selector in self.by_joint:
            return list(self.by_joint[selector])
        if not is_pattern(selector):
            return None
        found = {index for name, index in self.geometries.items() if fnmatch.fnmatchcase(name, selector)}
        for name in matching(selector, self.bodies):
            found.update(self.bodies[name])
        return sorted(found) or None

    def select_body(self, selector: Selector, argument: str = "body") -> str:
        """Return the name of one body: "world", a body's name, or a handle or part that has one body.

        Raises:
            InputError: unknown name, or a part of several bodies.
        """
        if isinstance(selector, str) and selector in ("world", "universe"):
            return "world"
        if isinstance(selector, str) and selector in self.bodies:
            return selector
        part = selector if isinstance(selector, PartHandle) else self.parts.get(_called(selector))
        bodies = () if part is None else tuple(name for name in part.bodies if name in self.bodies)
        if len(bodies) == 1:
            return bodies[0]
        known = ["world", *self.bodies]
        raise InputError(
            f"Unknown {argument}" if not bodies else f"{_called(selector)!r} has {len(bodies)} bodies",
            name=argument,
            expected="'world', the name of a body, or the handle of a part with one body",
            got=repr(_called(selector)),
            remedy=did_you_mean(_called(selector), bodies or known),
        )

    def select_joints(self, selector: Selector, argument: str = "joint") -> list[str]:
        """Return the names of the selected joints: a joint name, a pattern over them, or a part (all its joints).

        Raises:
            InputError: unknown name, or a part without joints.
        """
        found: list[str] = []
        if isinstance(selector, PartHandle):
            found = [name for name in selector.joints if name in self.by_joint]
        elif isinstance(selector, str) and selector in self.by_joint:
            found = [selector]
        elif isinstance(selector, str) and selector in self.parts:
            found = list(self.parts[selector].joints)
        elif isinstance(selector, str) and is_pattern(selector):
            found = matching(selector, self.joints)
        if not found:
            raise InputError(
                f"Unknown {argument}",
                name=argument,
                expected="the name of a joint, a pattern, or a part with joints",
                got=repr(_called(selector)),
                remedy=did_you_mean(
                    _called(selector), [*self.joints, *(name for name, part in self.parts.items() if part.joints)]
                ),
            )
        return found

    def select_placed(self, selector: Selector) -> list[str]:
        """Return the joints that a value belongs to: as `select_joints`, of a part on one free base that base.

        Raises:
            InputError: as `select_joints`.
        """
        found = self.select_joints(selector)
        is_part = isinstance(selector, PartHandle) or (selector in self.parts and selector not in self.by_joint)
        bases = {self._base[name] for name in found} if is_part else set()
        base = bases.pop() if len(bases) == 1 else None
        return found if base is None else [base]

    def select_joint(self, selector: Selector) -> str:
        """Return the name of the one selected joint, as `select_placed`; raise InputError for none and for several."""
        found = self.select_placed(selector)
        if len(found) != 1:
            raise InputError(
                f"Joint {_called(selector)!r}",
                name="joint",
                expected="one joint",
                got=f"{len(found)}",
                remedy="Name one of them: " + ", ".join(repr(joint) for joint in found[:6]),
            )
        return found[0]


def _called(selector: Selector) -> str:
    """Return what a selector is called."""
    try:
        return str(selector)
    except ValueError:  # of a whole number of more than 4300 digits
        return short(selector)


def is_pattern(text: str) -> bool:
    """Return whether a name is a pattern such as joint_*."""
    return any(mark in text for mark in _PATTERN)


def matching(pattern: str, names: Iterable[str]) -> list[str]:
    """Return the names that match a pattern, in their order."""
    return [name for name in names if fnmatch.fnmatchcase(name, pattern)]
