"""The scene: models, primitives, contact data and joint springs, assembled into one pin.Model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from contactvi.errors import InputError
from contactvi.importing.part import take_names
from contactvi.importing.readers import import_pinocchio
from contactvi.importing.report import ImportReport
from contactvi.inputs import real, vector
from contactvi.scene.assembly import assemble_visual
from contactvi.scene.build import Built, build, engine_scene
from contactvi.scene.data import scene_from_dict, scene_to_dict
from contactvi.scene.joint_values import joint_value, joint_velocity
from contactvi.scene.joints import joint_settings
from contactvi.scene.report import scene_report
from contactvi.scene.scene_elements import SceneElements
from contactvi.scene.scene_parts import GRAVITY
from contactvi.scene.selection import PartHandle, Selector

if TYPE_CHECKING:
    from contactvi import _core

__all__ = ["GRAVITY", "Scene"]


class Scene(SceneElements):
    """A set of rigid bodies with joints, contact geometry and contact data.

    Args:
        gravity: acceleration of free fall [m/s^2], world frame, shape (3,).

    Attributes:
        q0, v0: start of a run, shapes (nq,), (nv,); None unless the scene comes from a file.
        settings: settings of a run from the scene file (dt, duration, ...); empty otherwise.
    """

    def __init__(self, gravity: Sequence[float] | np.ndarray = GRAVITY) -> None:
        super().__init__(gravity)
        self.q0: np.ndarray | None = None
        self.v0: np.ndarray | None = None
        self.settings: dict[str, Any] = {}
        self._compiled: Any = None  # contactvi.trajectory.compiled, of the last run

    @property
    def gravity(self) -> np.ndarray:
        """Acceleration of free fall [m/s^2], world frame, shape (3,); a constant of the scene."""
        return self._gravity.copy()

    @classmethod
    def from_pinocchio(
        cls,
        model: pin.Model,
        collision_model: pin.GeometryModel | None = None,
        visual_model: pin.GeometryModel | None = None,
        name: str | None = None,
    ) -> Scene:
        """Return a scene with (a copy of) any pin.Model, with its gravity.

        Collision pairs in `collision_model` are taken as they are; without any, the default choice is made.
        """
        part = import_pinocchio(model, collision_model, visual_model, name)
        scene = cls(model.gravity.linear)
        scene._add(part)
        return scene

    def set_contact(
        self,
        a: Selector | None = None,
        b: Selector | None = None,
        *,
        restitution: float | None = None,
        friction: float | None = None,
    ) -> None:
        """Set restitution in [0, 1] and Coulomb friction >= 0 of contacts; by default 0.5 and 0.

        Restitution is Poisson's, the ratio of the impulses of expansion and compression, which without friction is that
        of the speeds; friction is isotropic and acts in impacts and in lasting contact. Without a and b: the scene's
        default (and, of restitution, that of joint limits). With a: of one body, part or geometry. With a and b: of the
        contacts between them. A pair uses its own value, else the smaller one of its two sides' values, else the
        default.
        """
        if a is None and b is not None:
            a, b = b, None
        first = None if a is None else self._geometries(a, "a")
        second = None if b is None else self._geometries(b, "b")
        checked = []
        if restitution is not None:
            checked.append((self._edits.restitution, real("restitution", restitution, 0.0, 1.0)))
        if friction is not None:
            checked.append((self._edits.friction, real("friction", friction, 0.0)))
        for rule, value in checked:
            if first is None:
                rule.default = value
            elif second is None:
                rule.set_single(first, value)
            else:
                rule.set_pair(first, second, value)
        self._built = None

    def set_joint(
        self,
        joint: Selector,
        *,
        stiffness: float | None = None,
        rest: Any = None,
        damping: Any = None,
        limits: bool | Sequence[float] | None = None,
        restitution: float | None = None,
        friction: bool | float | None = None,
        spring: Sequence[float] | None = None,
        armature: float | None = None,
        gear_ratio: float | None = None,
        rotor_inertia: float | None = None,
    ) -> None:
        """Set what acts in a joint, in all joints that match a pattern, or in a part's joints.

        Args:
            stiffness: [N m/rad or N/m]; for 1-dof, spherical and translation joints.
            rest: value of the joint where its springs rest (as in `configuration`); neutral when not given.
            damping: [N m s/rad or N s/m], replaces the file's; free and planar joints also take (linear, angular).
            limits: whether the model's limits stop the joint, or new ones (lower, upper).
            restitution: of impacts at the limits, in [0, 1]; the default contact restitution when not given.
            friction: dry friction [N m or N] of 1-dof joints: the force of slip, and what a joint at rest holds; True
                is the file's, False none (the default).
            spring: k1, k2, ... of a nonlinear spring besides `stiffness`: torque -(k1 x + k2 x^2 + ...), x = q - rest;
                of joints with one number in q.
            armature: inertia about the joint that moves no body [kg m^2 or kg], replaces the file's; not of free and
                planar joints.
            rotor_inertia, gear_ratio: add rotor_inertia * gear_ratio^2 to it (1 when not given).
        """
        model = self._assembled()[0].model
        values = {
            "stiffness": stiffness, "rest": rest, "damping": damping, "limits": limits, "restitution": restitution,
            "friction": friction, "spring": spring, "armature": armature, "gear_ratio": gear_ratio,
            "rotor_inertia": rotor_inertia,
        }  # fmt: skip
        self._update_joints({name: joint_settings(model, name, **values) for name in self._joints(joint)})

    def disable_pair(self, a: Selector, b: Selector) -> None:
        """Take all pairs between a and b out of the collision pairs."""
        self._switch_pair(a, b, self._edits.disabled)

    def enable_pair(self, a: Selector, b: Selector) -> None:
        """Put all pairs between a and b into the collision pairs, whatever the default choice says."""
        self._switch_pair(a, b, self._edits.enabled)

    def _switch_pair(self, a: Selector, b: Selector, pairs: list[tuple[str, str]]) -> None:
        others = self._geometries(b, "b")
        new = [(x, y) for x in self._geometries(a, "a") for y in others if x != y]
        for listed in (self._edits.disabled, self._edits.enabled):  # the last call wins
            listed[:] = [pair for pair in listed if pair not in new and pair[::-1] not in new]
        pairs += new
        self._built = None

    def _geometries(self, selector: Selector, argument: str) -> list[str]:
        names = self._assembled()[1]
        all_names = list(names.geometries)
        return [all_names[index] for index in names.select_geometries(selector, argument)]

    def _complete(self) -> Built:
        if self._built is None:
            assembly, names = self._assembled()
            self._built = build(assembly, self._parts, names, self._edits)
        return self._built

    @property
    def model(self) -> pin.Model:
        """The assembled model, with the damping and the limits that are simulated. Treat it as constant."""
        return self._complete().model

    @property
    def collision_model(self) -> pin.GeometryModel:
        """The collision geometry (convex shapes) with the tested collision pairs."""
        return self._complete().collision

    @property
    def visual_model(self) -> pin.GeometryModel:
        """The pictures; loaded on first use. Halfspaces are plates."""
        if self._visual is None:
            self._visual = assemble_visual(self._parts, self._assembled()[0].model)
        return self._visual

    @property
    def nq(self) -> int:
        return int(self._assembled()[0].model.nq)

    @property
    def nv(self) -> int:
        return int(self._assembled()[0].model.nv)

    @property
    def pair_names(self) -> list[tuple[str, str]]:
        """The tested pairs (geometry, geometry), in the engine's order."""
        return list(self._complete().pairs)

    @property
    def pair_restitution(self) -> np.ndarray:
        """Restitution of each tested pair, shape (npairs,)."""
        return self._complete().restitution.copy()

    @property
    def pair_friction(self) -> np.ndarray:
        """Coulomb friction of each tested pair, shape (npairs,)."""
        return self._complete().friction.copy()

    @property
    def parts(self) -> list[PartHandle]:
        """Handles of what was added, in order."""
        return list(self._groups.values())

    @property
    def report(self) -> ImportReport:
        """What of the models is used, changed, ignored, suspicious; pairs that are not tested; rounded shapes."""
        return scene_report(self._parts, self._complete(), self._edits)

    def core(self) -> _core.Scene:
        """Return the engine's scene (contactvi._core.Scene), built on first use and again after an edit."""
        return engine_scene(self._complete())

    def neutral(self) -> np.ndarray:
        """Return the neutral configuration, shape (nq,): joints at zero or the nearest limit, free bodies as placed."""
        return self._complete().start.copy()

    def spring_rest(self) -> np.ndarray:
        """Return the configuration where every spring rests, neutral for joints without one, shape (nq,)."""
        return self._complete().arrays.rest.copy()

    def q_index(self, joint: Selector) -> slice:
        """Return where a joint's numbers lie in q."""
        found = self._one_joint(joint)
        return slice(found.idx_q, found.idx_q + found.nq)

    def v_index(self, joint: Selector) -> slice:
        """Return where a joint's numbers lie in v."""
        found = self._one_joint(joint)
        return slice(found.idx_v, found.idx_v + found.nv)

    def configuration(self, values: Mapping[Any, Any], base: np.ndarray | None = None) -> np.ndarray:
        """Return `base` (neutral when None) with the values of some joints, shape (nq,).

        Keys: joint names, patterns, handles. Values: rad or m; free body: xyz, (xyz, rpy), xyz + quaternion xyzw or
        pin.SE3; spherical: quaternion xyzw; planar: x, y, angle; translation: x, y, z.
        """
        model = self.model
        q = self.neutral() if base is None else vector("base", base, model.nq)
        for selector, value in values.items():
            for name in self._assembled()[1].select_joints(selector):
                q[self.q_index(name)] = joint_value(model, name, value)
        return q

    def velocity(self, values: Mapping[Any, Any], q: np.ndarray | None = None) -> np.ndarray:
        """Return the velocity of some joints, zero for the others, shape (nv,), Pinocchio coordinates.

        Values: rad/s or m/s; free body: linear or (linear, angular) in world axes at configuration q; else 3 numbers.
        """
        model = self.model
        q = self.neutral() if q is None else vector("q", q, model.nq)
        v = np.zeros(model.nv)
        for selector, value in values.items():
            for name in self._assembled()[1].select_joints(selector):
                v[self.v_index(name)] = joint_velocity(model, name, value, q)
        return v

    def _one_joint(self, joint: Selector) -> pin.JointModel:
        assembly, names = self._assembled()
        found = names.select_joints(joint)
        if len(found) != 1:
            raise InputError(f"Joint {str(joint)!r}", name="joint", expected="one joint", got=f"{len(found)}")
        return assembly.model.joints[assembly.model.getJointId(found[0])]

    def to_dict(self) -> dict[str, Any]:
        """Return a complete description in plain data (see scene_data.py); from_dict makes the same scene of it."""
        data = scene_to_dict(self._complete(), self._edits, self.parts)
        start = {name: None if q is None else q.tolist() for name, q in (("q0", self.q0), ("v0", self.v0))}
        return data | start | {"settings": dict(self.settings)}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Scene:
        """Return the scene of to_dict. Raises SceneError when the data are not such a description."""
        stored = scene_from_dict(data)
        scene = cls(stored.gravity)
        take_names(stored.part, scene._taken)
        scene._parts, scene._groups, scene._edits = [stored.part], stored.groups, stored.edits
        for name in ("q0", "v0"):
            setattr(scene, name, None if data.get(name) is None else np.array(data[name], dtype=float))
        scene.settings = dict(data.get("settings", {}))
        return scene
