"""The scene: models, primitives, contact data, joint settings and elements, assembled into one pin.Model."""

from __future__ import annotations

import copy
import os
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from contactvi.errors import InputError, did_you_mean
from contactvi.importing.given_surfaces import GivenSurface
from contactvi.importing.mjcf.actuators import Actuator
from contactvi.importing.mjcf.model import MjcfFile
from contactvi.importing.part import Part
from contactvi.importing.pictures import Picture
from contactvi.importing.pinocchio_models import import_pinocchio
from contactvi.importing.readers import import_mjcf, import_urdf, open_mjcf
from contactvi.importing.report import ImportReport
from contactvi.inputs import flag, pose, vector, warn_of_degrees
from contactvi.keywords import no_attribute, refusing_methods
from contactvi.scene.build import Built, build
from contactvi.scene.camera import Camera, bodies_to_follow, camera_of, check_followed
from contactvi.scene.contact_rules import ContactRules
from contactvi.scene.data import scene_from_dict, scene_to_dict, target_name
from contactvi.scene.dynamics import SceneDynamics
from contactvi.scene.element_list import ElementList
from contactvi.scene.joints import (
    JointSettings,
    JointTable,
    Servo,
    is_revolute,
    joint_settings,
    servo_settings,
    with_armature,
    with_one_dof,
)
from contactvi.scene.notes import Notes, noted
from contactvi.scene.pairs import within_models
from contactvi.scene.parameter_values import ParameterEditor, ParameterValues
from contactvi.scene.parts import Handle, PartList
from contactvi.scene.report import scene_report
from contactvi.scene.scene_contacts import SceneContacts
from contactvi.scene.scene_elements import SceneElements
from contactvi.scene.scene_shapes import SceneShapes
from contactvi.scene.scene_states import SceneStates
from contactvi.scene.selection import Names, PartHandle, Selector
from contactvi.scene.shown import refuse_attribute, scene_html, scene_line, scene_text
from contactvi.scene.surfaces import FunctionSurface, function_surface, missing_name
from contactvi.scene.written import save_scene

GRAVITY = (0.0, 0.0, -9.81)
_SETTABLE = ("q0", "v0", "settings", "camera", "compiled")


@refusing_methods
@noted
class Scene(SceneShapes, SceneElements, SceneContacts, SceneStates, SceneDynamics):
    """A set of rigid bodies with joints, contact geometry, contact data, constraints and forces.

    Where a method takes a body, a joint or a geometry, it is named by its name, by a handle that an `add_` method
    returned, or by a pattern with * ? [] where several are meant. "world" is the ground. Points [m] and placements are
    in the frames of their bodies. Each constraint, spring or force has a name, given or its kind with a number, which
    the method that adds it returns; what is None is taken as it is in the neutral configuration when the scene is run.
    All methods raise InputError for bad values and unknown names, and then change nothing.

    The scene owns what the user gives, each kind in one place: the parts (`PartList`), restitution, friction and pairs
    of contacts (`ContactRules`), joint settings (`JointTable`) and elements (`ElementList`). Its methods check their
    arguments and hand them on. The complete scene (`built`) is made of them on first use and again after an edit.

    Args:
        gravity: acceleration of free fall [m/s^2], world frame, shape (3,).

    Attributes:
        q0, v0: start of a run, shapes (nq,), (nv,); None unless the scene comes from a file.
        settings: settings of a run from the scene file (dt, duration, ...); empty otherwise.
    """

    def __init__(self, gravity: ArrayLike = GRAVITY) -> None:
        self._parts = PartList(vector("gravity", gravity, 3))
        self._contact = ContactRules()
        self._joints = JointTable()
        self._elements = ElementList()
        self._apart: frozenset[tuple[str, str]] = frozenset()  # tested although they overlap at the neutral pose
        self._notes = Notes()  # of the calls that make the scene, for `save`
        self._built: Built | None = None  # made of the four owners; every edit drops it
        self.q0: np.ndarray | None = None
        self.v0: np.ndarray | None = None
        self.settings: dict[str, Any] = {}
        self._camera: Camera | None = None
        # What contactvi.trajectory.compiled makes of the scene for its runs. It stands here for the garbage collector:
        # functions of the user in it may hold the scene in turn.
        self.compiled: object = None

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute that a scene has; another one would have no effect.

        Raises:
            InputError: for what it has not, and what only its methods change.
        """
        if type(self) is Scene and not name.startswith("_") and name not in _SETTABLE:
            refuse_attribute(name, type(self), _SETTABLE)
        super().__setattr__(name, value)

    def __getattr__(self, name: str) -> Any:
        """Raise AttributeError for an attribute that a scene has not, with what may have been meant."""
        if hasattr(type(self), name):  # a property that failed for want of another attribute: its own error
            return object.__getattribute__(self, name)
        raise AttributeError(no_attribute("A scene", name, dir(type(self))))

    def __repr__(self) -> str:
        return scene_line(self, None if self._built is None else self._built.pairs)

    def __str__(self) -> str:
        return scene_text(self)

    def _repr_html_(self) -> str:
        """Return what a notebook shows."""
        return scene_html(self)

    @property
    def camera(self) -> str | dict[str, Any] | None:
        """Where pictures are taken from unless they say so, as of `Trajectory.to_html`; None: from the open side."""
        return None if self._camera is None else self._camera.to_data()

    @camera.setter
    def camera(self, value: Any) -> None:
        camera = None if value is None else camera_of(value)
        if camera is not None:
            check_followed(camera, bodies_to_follow(self))
        self._camera = camera

    # --- parts --------------------------------------------------------------------------------------------------------

    @classmethod
    def from_pinocchio(
        cls,
        model: pin.Model,
        collision_model: pin.GeometryModel | None = None,
        visual_model: pin.GeometryModel | None = None,
        name: str | None = None,
        self_collision: bool = True,
    ) -> Scene:
        """Return a scene with a copy of any pin.Model, and with its gravity.

        Collision pairs in `collision_model` are taken as they are; without any, the default choice is made.
        self_collision as in add_urdf.
        """
        part = import_pinocchio(model, collision_model, visual_model, name)
        part.self_collision = flag("self_collision", self_collision)
        scene = cls(model.gravity.linear)
        scene._add(part, PartHandle)
        scene._notes.lost = "a model that was given as a pin.Model"
        return scene

    def add_urdf(
        self,
        path: str | os.PathLike[str],
        *,
        base: str = "fixed",
        placement: Any = None,
        package_dirs: Sequence[str | os.PathLike[str]] = (),
        srdf: str | os.PathLike[str] | None = None,
        prefix: str = "",
        limits: bool = True,
        friction: bool = False,
        mimic: bool = True,
        armature: float | Mapping[str, float] | None = None,
        self_collision: bool = True,
        contact_friction: bool = False,
        shape: str | Mapping[str, str] | None = None,
        spacing: float | None = None,
    ) -> PartHandle:
        """Add a URDF model. Meshes become convex hulls unless `shape` says so, mimic tags couple joints (see `report`).

        Args:
            path: file, or `package://...`, `example-robot-data://robots/...`.
            base: "fixed" to the world or "free" (a free-flyer named root_joint).
            placement: of the base in the world: None, xyz [m], (xyz, rpy [rad]), 7 numbers (xyz, quaternion xyzw) or
                pin.SE3. For a free base it is where neutral() puts it.
            package_dirs: folders in which to look for packages first.
            srdf: file whose disable_collisions are left out of the collision pairs.
            prefix: put before all names, to add the same model twice.
            limits: whether the limits of its joints stop them (lower >= upper means none); one by one: `set_joint`.
            friction: whether its joints have the friction of the file; one by one: `set_joint(friction=True)`.
            mimic: whether joints with a mimic tag follow the other joint (a linear joint equality, which makes the two
                one coordinate); else they are independent.
            armature: inertia [kg m^2 or kg] about all joints with one degree of freedom that moves no body, or
                {name or pattern: inertia}; a joint that moves no mass needs one.
            self_collision: whether its links may touch each other; single pairs: `enable_pair`, `disable_pair`.
            contact_friction: whether its shapes have the friction that the file gives them for Drake (mu_dynamic),
                Bullet (lateral_friction) or Gazebo (the smaller one of mu1 and mu2).
            shape: what collision meshes become: "hull"; "pieces", convex ones by CoACD (`add_mesh(decompose=True)`),
                called name_0, name_1, ...; "field", a solid of their shape (`add_mesh(spacing=)`). For all, or {name or
                pattern: shape} of geometries or mesh files as the model has them, without the prefix; the others are
                hulls. The report says which was taken, and how far its surface is from the mesh, measured both ways at
                some thousand places: the largest and the mean distance. None: hulls, without that.
            spacing: of the samples of fields [m]; None: a fortieth of the longest edge of each mesh.

        Raises:
            SceneError, UnsupportedJointError, InputError
        """
        dirs = [package_dirs] if isinstance(package_dirs, (str, os.PathLike)) else package_dirs
        where = pose("placement", placement)
        part = import_urdf(
            path, base=base, placement=where, package_dirs=dirs, srdf=srdf, prefix=prefix, mimic=mimic,
            armature=armature, contact_friction=contact_friction, shape=shape, spacing=spacing,
        )  # fmt: skip
        return self.add_model(part, limits, friction, self_collision)

    @classmethod
    def from_mjcf(cls, path: str | os.PathLike[str], **options: Any) -> Scene:
        """Return a scene with an MJCF and with its gravity; options as in add_mjcf."""
        opened = open_mjcf(path)
        scene = cls(opened.gravity)
        scene.add_mjcf(opened, **options)
        return scene

    def add_mjcf(
        self,
        path: str | os.PathLike[str] | MjcfFile,
        *,
        placement: Any = None,
        prefix: str = "",
        limits: bool = True,
        friction: bool = False,
        equality: bool = True,
        actuators: bool = True,
        restitution: float | str | None = 0.0,
        self_collision: bool = True,
        allow: Sequence[str] = (),
        turning_friction: bool = False,
        hfield: str = "prisms",
        shape: str | Mapping[str, str] | None = None,
        spacing: float | None = None,
    ) -> PartHandle:
        """Add an MJCF, compiled by MuJoCo (needs `pip install "contactvi[mjcf]"`). The rest as in add_urdf.

        The file says which of its geoms may touch, and their friction; what the engine has no place for is in `report`.
        Geoms are rigid, planes endless, meshes convex unless `shape` says so. Keyframes are in `named_configurations`;
        gravity is the scene's.

        Args:
            friction: whether joints have their frictionloss.
            equality: whether its <equality> become constraints.
            actuators: whether its position and velocity actuators become servos, whose target is the start unless the
                run gives one; `Scene.actuators` has the numbers of all by name.
            restitution: of the contacts in the file and with it and of the limits, in [0, 1]; "solref": of its contacts
                what a spring and damper with the file's damping ratio has (0.135 for MuJoCo's default); None: as set by
                `set_contact`.
            allow: deformable bodies are refused (SceneError); ("flex",) takes the vertices of each <flex> and
                <flexcomp> as loose bodies, without elasticity and contact surface.
            turning_friction: whether contacts of condim 4 and 6 have the file's torsional and rolling friction
                (`set_contact`: spinning_radius = torsional / sliding, rolling_radius = rolling).
            hfield: of height fields "prisms": the triangles of the file, two convex prisms to a cell, with seams;
                "smooth": one bicubic surface through the samples, as `add_heightfield`. The report says how far it is
                from the triangles.
            shape, spacing: as in add_urdf, by the names of geoms or meshes. Of an SDF plugin the mesh is meant that
                MuJoCo makes of it.
        """
        where = pose("placement", placement)
        opened = path if isinstance(path, MjcfFile) else open_mjcf(path)
        part = import_mjcf(
            opened, placement=where, gravity=self.gravity, prefix=prefix, equality=equality, actuators=actuators,
            restitution=restitution, allow=allow, turning_friction=turning_friction, hfield=hfield,
            shape=shape, spacing=spacing,
        )  # fmt: skip
        return self.add_model(part, limits, friction, self_collision)

    def add_model(self, part: Part, limits: Any, friction: Any = False, self_collision: Any = True) -> PartHandle:
        """Add an imported model (for scene files); `limits`, `friction` and `self_collision` as in add_urdf."""
        limits, friction = flag("limits", limits), flag("friction", friction)
        part.self_collision = flag("self_collision", self_collision)
        handle = self._add(part, PartHandle)
        self._joints.add_part(part, limits, friction)
        self._contact.add_part(part)
        self._elements.add_from_file(part.data.elements)
        return handle

    # --- contacts and joints ------------------------------------------------------------------------------------------

    def disable_overlapping(self, q: ArrayLike | None = None) -> list[tuple[str, str]]:
        """Take the pairs within one model that overlap at q (nq,), neutral when None, out of the collision pairs.

        Links of many robots overlap by millimetres in their own poses. Pairs of different parts, and of what is fixed
        to the world with a free body, stay: there the start is wrong. Returns the pairs.
        """
        gaps = np.asarray(self.core().gaps(self._state(q))[0])
        inner = within_models(self._parts.assembly)
        found = [(a, b) for (a, b), gap in zip(self.pair_names, gaps, strict=True) if gap < 0.0 and inner(a, b)]
        for a, b in found:
            self._contact.disable([a], [b])
        self._built = None
        return found

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
        spring: ArrayLike | None = None,
        armature: float | None = None,
        gear_ratio: float | None = None,
        rotor_inertia: float | None = None,
    ) -> None:
        """Set what acts in a joint, in all joints that match a pattern, or in a part's joints.

        Args:
            joint: a name, pattern or part. Of several joints, friction and armature are set where they have a meaning:
                a free base is left out.
            stiffness: [N m/rad or N/m]; for 1-dof, spherical and translation joints.
            rest: value of the joint where its springs rest (as in `configuration`); neutral when not given.
            damping: [N m s/rad or N s/m], replaces the file's; free and planar joints also take (linear, angular).
            limits: whether the model's limits stop the joint, or new ones (lower, upper).
            restitution: of impacts at the limits, in [0, 1]; the default contact restitution when not given.
            friction: joint friction [N m or N] of 1-dof joints: the force of slip, and what a joint at rest holds; True
                is the file's, False none (the default).
            spring: k1, k2, ... of a nonlinear spring besides `stiffness`: torque -(k1 x + k2 x^2 + ...), x = q - rest;
                of joints with one number in q.
            armature: inertia about the joint that moves no body [kg m^2 or kg], replaces the file's; not of free and
                planar joints.
            rotor_inertia, gear_ratio: add rotor_inertia * gear_ratio^2 to it (1 when not given).
        """
        model, names = self._parts.assembly.model, self.names.select_joints(joint)
        every = {
            "stiffness": stiffness, "rest": rest, "damping": damping, "limits": limits, "restitution": restitution,
            "spring": spring,
        }  # fmt: skip
        motors = {"armature": armature, "gear_ratio": gear_ratio, "rotor_inertia": rotor_inertia}
        chosen = (
            (names, every),
            (with_one_dof(model, names), {"friction": friction}),
            (with_armature(model, names), motors),
        )
        settings: dict[str, JointSettings] = {}
        for own, values in chosen:
            for name in own:
                settings.setdefault(name, JointSettings()).update(joint_settings(model, name, **values))
        self._joints.update(settings)  # all or none
        for what, angles in (("rest", rest), ("limits", limits)):
            if angles is not None and not isinstance(angles, bool) and any(is_revolute(model, name) for name in names):
                warn_of_degrees(f"{what} of joint {names[0]!r}", np.asarray(angles, dtype=float))
        self._built = None

    def set_servo(self, joint: Selector, kp: float, kd: float, effort: float | None = None, target: Any = None) -> None:
        """Control joints by PD in the engine: torque kp (q_ref - q) + kd (v_ref - v), at most effort.

        The damping of the joint's file stays on beside kd: a joint of little inertia then comes to its target within
        some (kd + damping) / kp seconds, which `report` names; `set_joint(joint, damping=0.0)` takes it out.

        Args:
            joint: joints with one degree of freedom, by name, pattern or part, whose other joints (a free base) have no
                servo; continuous ones go the shorter way.
            kp, kd: [N m/rad or N/m], [N m s/rad or N s/m], >= 0, both 0 for no servo. They are implicit in the step and
                may be stiff.
            effort: largest torque [N m or N]; None: the file's limit, float("inf"): none.
            target: reference of a run that gives none itself (`simulate(target=)`): a motion as in `prescribe`; None:
                the start.
        """
        model = self._parts.assembly.model
        names = with_one_dof(model, self.names.select_joints(joint))
        self._joints.update({name: servo_settings(model, name, kp, kd, effort, target) for name in names})
        self._elements.supply({target_name(name) for name in names})
        self._built = None

    def set_actuator(
        self, joint: Selector, effort: bool | float | None = None, velocity: bool | float | None = None
    ) -> None:
        """Limit what inputs do at joints, of a part or pattern at those with one degree of freedom; none by default.

        effort [N m or N], velocity [rad/s or m/s] : a number, True for the file's limit, False for none. The torque put
        in is cut to +-effort, and may not push a joint beyond +-velocity; that is decided at the start of each step.
        """
        model = self._parts.assembly.model
        self._set_joints(with_one_dof(model, self.names.select_joints(joint)), effort=effort, velocity=velocity)

    def set_surface(
        self,
        name: str,
        *,
        height: Any = None,
        distance: Any = None,
        gradient: Any = None,
        hessian: Any = None,
        extent: ArrayLike | None = None,
    ) -> None:
        """Set the function of a surface again, as of `add_surface`: another one, or that of a scene that was stored.

        Raises:
            InputError, UserFunctionError: as `add_surface`; there is no such surface, or one of the other kind.
        """
        known = self.surfaces.get(name)
        box = known.extent if extent is None and isinstance(known, FunctionSurface) else extent
        surface = function_surface(height, distance, gradient, hessian, box)
        if known is None or known.kind != surface.kind:
            raise InputError(
                "Unknown surface", name="name", expected=f"a surface given by a {surface.kind}",
                got=repr(name), remedy=did_you_mean(str(name), list(self.surfaces)),
            )  # fmt: skip
        surface.check(name)
        self._parts.set_surface(name, surface)
        self._elements.supply({missing_name(name)})
        self._built = None

    # --- what the scene is --------------------------------------------------------------------------------------------

    @property
    def gravity(self) -> np.ndarray:
        """Acceleration of free fall [m/s^2], world frame, shape (3,); a constant of the scene."""
        return self._parts.gravity.copy()

    @property
    def names(self) -> Names:
        """The names of joints, bodies, geometries and parts, and what handles and patterns select."""
        return self._parts.names

    @property
    def missing(self) -> list[str]:
        """Names of elements and servo targets that a stored scene lost, because Python functions gave them."""
        return list(self._elements.missing)

    def built(self) -> Built:
        """Return the complete scene: one model with its pairs, joint arrays and elements. Treat it as constant."""
        if self._built is None:
            self._built = build(self._parts, self._contact, self._joints, self._elements.elements, self._apart)
        return self._built

    @property
    def servo_joints(self) -> list[str]:
        """The joints with a servo, in the order of v."""
        return list(self.built().servo_joints)

    @property
    def model(self) -> pin.Model:
        """The assembled model, with the damping and the limits that are simulated. Treat it as constant."""
        return self.built().model

    @property
    def collision_model(self) -> pin.GeometryModel:
        """The collision geometry (convex shapes) with the tested collision pairs."""
        return self.built().collision

    @property
    def visual_model(self) -> pin.GeometryModel:
        """The pictures; loaded on first use. Halfspaces are plates."""
        return self._parts.visual

    @property
    def surfaces(self) -> dict[str, GivenSurface]:
        """The surfaces given by functions, by the names of their geometries."""
        return self._parts.surfaces

    def pictures(self) -> list[Picture]:
        """Return what is drawn, as `visual_model` with meshes as plain arrays; loaded on first use."""
        return self._parts.pictures

    @property
    def nq(self) -> int:
        return int(self._parts.assembly.model.nq)

    @property
    def nv(self) -> int:
        return int(self._parts.assembly.model.nv)

    @property
    def pair_names(self) -> list[tuple[str, str]]:
        """The tested pairs (geometry, geometry), in the engine's order."""
        return list(self.built().pairs)

    @property
    def compliant_pairs(self) -> list[tuple[str, str]]:
        """The compliant pairs (geometry, geometry), in the order of `Trajectory.compliant_contacts`."""
        return [row.names for row in self.built().elements.compliances]

    @property
    def pair_restitution(self) -> np.ndarray:
        """Restitution of each tested pair, shape (npairs,)."""
        return self.built().restitution.copy()

    @property
    def pair_friction(self) -> np.ndarray:
        """Coulomb friction of each tested pair, shape (npairs,)."""
        return self.built().friction.copy()

    @property
    def parts(self) -> list[PartHandle]:
        """Handles of what was added, in order."""
        return list(self._parts.handles.values())

    @property
    def actuators(self) -> dict[str, Actuator]:
        """The actuators of the scene's MJCFs by name: joint or body, gains and ranges (`Actuator`); in their order."""
        return {actuator.name: actuator for part in self.parts for actuator in part.actuators}

    @property
    def report(self) -> ImportReport:
        """Which data of the models are used, changed, ignored, suspicious; untested pairs; rounded shapes."""
        return scene_report(self._parts.parts, self.built(), self._joints, self._elements)

    def core(self) -> Any:
        """Return the engine's scene (contactvi._core.Scene), built on first use and again after an edit."""
        return self.built().engine

    # --- parameters by the names of derivatives -----------------------------------------------------------------------

    def parameter(self, name: str) -> np.ndarray:
        """Return the value of a parameter by the name that contactvi.gradient gives it, of the gradient's shape.

        "gravity" (3,); "mass:joint", "stiffness:joint" (1,); "inertia:joint" (10,): mass, first moment, rotational
        inertia about the joint's frame (xx xy xz yy yz zz); "armature:joint", with what the rotor adds,
        "damping:joint", "rest:joint", "kp:joint", "kd:joint" (dofs,); "restitution", "friction" (1,) of all contacts
        that have some, where it is one value; "restitution:a|b", "friction:a|b" (1,) of a pair of shapes;
        "restitution:joint" (1,) of the limits of a joint.

        Raises:
            InputError: an unknown name; something that the joint has not; contacts of different values.
        """
        return ParameterValues(self.built()).of(name)

    def with_parameters(self, values: Mapping[str, Any]) -> Scene:
        """Return a copy with other values of parameters, by the names of `parameter`; this scene stays as it is.

        A mass is set at a constant centre of mass and rotational inertia about it.

        Args:
            values: name -> value of the shape that `parameter` returns, or one number.

        Raises:
            InputError: as `parameter`; a value of the wrong shape or that no scene has; two names of one number.
        """
        twin = self.copy()
        twin._notes.lost = "parameters that with_parameters has changed"
        ParameterEditor(ParameterValues(self.built()), twin._parts, twin._contact, twin._joints).set(values)
        twin._built = None
        return twin

    # --- copies and plain data ----------------------------------------------------------------------------------------

    def with_apart(self, pairs: Collection[tuple[str, str]]) -> Scene:
        """Return a copy that tests just these of the pairs that overlap at the neutral pose (for runs, `at_start`)."""
        twin = self.copy()
        twin._apart, twin._built = frozenset(pairs), None
        return twin

    def copy(self) -> Scene:
        """Return a scene that is edited apart from this one; what is built is shared until one of them is edited."""
        twin = type(self).__new__(type(self))
        vars(twin).update(vars(self))
        twin._parts, twin._contact = self._parts.copy(), self._contact.copy()
        twin._joints, twin._elements = self._joints.copy(), self._elements.copy()
        twin.settings, twin.compiled = dict(self.settings), None
        twin._notes = self._notes.copy()
        return twin

    def __copy__(self) -> Scene:
        return self.copy()

    def __deepcopy__(self, memo: Any) -> Scene:
        """Return a copy with a start and settings of its own; elements and what is built are constant and shared."""
        twin = self.copy()
        twin.q0, twin.v0, twin.settings = copy.deepcopy((self.q0, self.v0, self.settings), memo)
        return twin

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what pickle keeps: the data of to_dict, and what these leave out because Python functions gave it."""
        goals = {name: goal for name, goal in self.built().arrays.targets.items() if not goal.storable}
        return _restored, (type(self), self.to_dict(), self._elements, goals, self.surfaces)

    def to_dict(self) -> dict[str, Any]:
        """Return a complete description in plain data (contactvi.scene.data); from_dict makes a scene of it again."""
        data = scene_to_dict(self.built(), self._contact, self._elements, self.parts)
        start = {name: None if x is None else np.asarray(x).tolist() for name, x in (("q0", self.q0), ("v0", self.v0))}
        return data | start | {"settings": dict(self.settings), "camera": self.camera}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Scene:
        """Return the scene of to_dict. Raises SceneError when the data are not such a description."""
        stored = scene_from_dict(data)
        scene = cls(stored.gravity)
        scene._parts.add_stored(stored.part, stored.handles)
        scene._contact, scene._joints, scene._elements = stored.contact, stored.joints, stored.elements
        scene.q0, scene.v0, scene.settings = stored.q0, stored.v0, stored.settings
        scene._apart = stored.apart
        scene._camera = stored.camera
        scene._notes.lost = "a scene that comes from a stored run or from pickle, which do not keep how it was made"
        return scene

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
        """Write the scene as a scene file (contactvi.scene.toml), which loads back to an equal scene; return its path.

        With its start, settings and camera. Paths are written relative to the file. What is written is read back and
        compared, numbers to rounding, before the file is put in place.

        Args:
            path: of the file, whose name ends in .toml.
            overwrite: whether a file of this name is replaced.

        Raises:
            SceneError: the scene has what no scene file holds, which the error names: functions, models and meshes that
                were given as arrays, stored scenes.
            OverwriteError: there is such a file. InputError: it cannot be written.
        """
        return save_scene(self, self._notes, path, overwrite)

    def note(self, notes: Notes) -> None:
        """Take the notes of a file from which the scene was read (for scene files)."""
        self._notes = notes

    def restore(self, elements: ElementList, goals: Mapping[str, Any], surfaces: Mapping[str, GivenSurface]) -> None:
        """Give a scene from data the elements, motions of servos and surfaces that data do not hold (for pickle)."""
        self._elements = elements
        for name, surface in surfaces.items():
            self._parts.set_surface(name, surface)
        for name, goal in goals.items():
            servo = self._joints.of(name).servo
            assert servo is not None
            self._joints.update({name: JointSettings(servo=Servo(servo.kp, servo.kd, servo.effort, goal))})

    # --- helpers ------------------------------------------------------------------------------------------------------

    def _add(self, part: Part, kind: type[Handle]) -> Handle:
        handle = self._parts.add(part, kind)
        self._built = None
        return handle

    def _set_joints(self, names: list[str], **values: Any) -> None:
        model = self._parts.assembly.model
        self._joints.update({name: joint_settings(model, name, **values) for name in names})
        self._built = None


def _restored(
    kind: type[Scene],
    data: Mapping[str, Any],
    elements: ElementList,
    goals: Mapping[str, Any],
    surfaces: Mapping[str, GivenSurface],
) -> Scene:
    """Return a scene from what pickle kept; goals: motions of servos by joint name."""
    scene = kind.from_dict(data)
    scene.restore(elements, goals, surfaces)
    return scene
