"""A contactvi scene as a MuJoCo model, for running both beside each other; needs the package mujoco.

The model is made from the complete scene: the same tree, inertias, dampings, armatures, limits, joint springs and
servos, and the same shapes, meshes as the convex hulls that contactvi has made of them (sharp: the rounding of edges is
contactvi's alone). All contacts have one friction and one restitution, those of the scene's pairs, and the same pairs
are tested.

Contacts and limits are as stiff as MuJoCo allows: `stiff_contact`. Elliptic cones, integrator implicitfast.
"""

from __future__ import annotations

import importlib
import itertools
import math
from collections import Counter, defaultdict
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.errors import InputError
from contactvi.scene.scene import Scene

Array = NDArray[np.float64]
_UNIFORM = "one value for all pairs"
_LEAST = 1e-12  # [kg, kg m^2] of a frame without mass, which in MuJoCo is a body


def stiff_contact(dt: float, restitution: float = 0.0) -> list[float]:
    """Return solref of the stiffest contact that MuJoCo allows at a step, with a restitution.

    Time constant 2 dt and damping ratio 1 mean the stiffness k = 1 / (2 dt)^2 and the damping 2 sqrt(k), per mass. With
    restitution k stays and the damping is less; then both are given by themselves, as negative numbers.
    """
    if restitution == 0.0:
        return [2.0 * dt, 1.0]
    stiffness = 0.25 / dt**2
    return [-stiffness, -2.0 * damping_ratio(restitution) * math.sqrt(stiffness)]


def damping_ratio(restitution: float) -> float:
    """Return the damping ratio of a spring and damper that can only push and give a mass back with this restitution.

    By bisection up to nearly critical damping, which still gives back exp(-2) of the speed: no less is possible. In
    units of the natural frequency x = -exp(-z t) sin(w t) / w; the contact ends where the force x + 2 z x' is zero.
    """
    if restitution >= 1.0:
        return 0.0
    low, high = 0.0, 0.99
    for _ in range(60):
        z = 0.5 * (low + high)
        w = math.sqrt(1.0 - z * z)
        end = math.atan2(2.0 * z * w, 2.0 * z * z - 1.0) / w
        back = -math.exp(-z * end) * (math.cos(w * end) - z / w * math.sin(w * end))
        low, high = (z, high) if back > restitution else (low, z)
    return low


class MujocoPeer:
    """The MuJoCo model of a scene, and the way between the states of both.

    Attributes:
        mujoco: the package.
        model: the MjModel.
        servos: actuator and number of the joint of each servo.
    """

    def __init__(self, scene: Scene, dt: float) -> None:
        """Convert a scene for a time step dt [s].

        Raises:
            InputError: for a scene with elements, joint friction, other joints than free, revolute, continuous and
                prismatic ones, or pairs that differ in friction or restitution.
        """
        self.mujoco = importlib.import_module("mujoco")
        self._scene, self._built = scene, scene.built()
        self._joints = list(self._built.model.joints)[1:]
        self._names = list(self._built.model.names)[1:]
        self._contact = self._contact_settings(dt)
        spec = self._new_spec(dt)
        bodies = self._add_bodies(spec, dt)
        self._add_shapes(spec, bodies)
        self._choose_pairs(spec)
        servos = self._add_servos(spec)
        self.model = spec.compile()
        kinds, find = self.mujoco.mjtObj, self.mujoco.mj_name2id
        numbers = [find(self.model, kinds.mjOBJ_JOINT, name) for name in self._names]
        self._at_q = [int(self.model.jnt_qposadr[k]) for k in numbers]
        self._at_v = [int(self.model.jnt_dofadr[k]) for k in numbers]
        self.servos = [(find(self.model, kinds.mjOBJ_ACTUATOR, name), self._names.index(name)) for name in servos]

    # --- states -------------------------------------------------------------------------------------------------------
    def data(self, q: Array, v: Array) -> Any:
        """Return a new MjData at contactvi's state, shapes (nq,), (nv,); its servos hold the joints where they are."""
        data = self.mujoco.MjData(self.model)
        for joint, at_q, at_v in zip(self._joints, self._at_q, self._at_v, strict=True):
            iq, iv = joint.idx_q, joint.idx_v
            if (
                joint.nv == 6
            ):  # In MuJoCo the linear velocity is along the world's axes, the angular one along the body's.
                x, y, z, w = q[iq + 3 : iq + 7]
                data.qpos[at_q : at_q + 7] = [*q[iq : iq + 3], w, x, y, z]
                data.qvel[at_v : at_v + 3] = pin.Quaternion(w, x, y, z).matrix() @ v[iv : iv + 3]
                data.qvel[at_v + 3 : at_v + 6] = v[iv + 3 : iv + 6]
            else:
                data.qpos[at_q] = q[iq] if joint.nq == 1 else math.atan2(q[iq + 1], q[iq])
                data.qvel[at_v] = v[iv]
        for number, joint in self.servos:
            data.ctrl[number] = data.qpos[self._at_q[joint]]
        return data

    def configuration(self, qpos: Array) -> Array:
        """Return contactvi's q, shape (nq,), of MuJoCo's qpos."""
        q = np.zeros(self._scene.nq)
        for joint, at in zip(self._joints, self._at_q, strict=True):
            iq = joint.idx_q
            if joint.nv == 6:
                q[iq : iq + 7] = qpos[[at, at + 1, at + 2, at + 4, at + 5, at + 6, at + 3]]
            elif joint.nq == 1:
                q[iq] = qpos[at]
            else:
                q[iq : iq + 2] = math.cos(qpos[at]), math.sin(qpos[at])
        return q

    # --- the model ----------------------------------------------------------------------------------------------------
    def _contact_settings(self, dt: float) -> dict[str, Any]:
        built = self._built
        if built.elements.any or built.arrays.polynomials or np.any(built.arrays.joint_friction):
            raise InputError(
                "A MuJoCo model is made of joints, shapes and servos only",
                name="scene",
                expected="a scene without other elements",
                got="springs, forces, constraints or joint friction",
                remedy="Take springs, forces, constraints and joint friction out of the scene",
            )
        values = []
        for name, numbers in (("friction", built.friction), ("restitution", built.restitution)):
            if len(numbers) and np.ptp(numbers) > 0.0:
                raise InputError(
                    "The pairs differ",
                    name=name,
                    expected=_UNIFORM,
                    got=sorted(set(numbers.tolist())),
                    remedy=f"Set one for all: scene.set_contact({name}=...)",
                )
            values.append(float(numbers[0]) if len(numbers) else 0.0)
        friction, restitution = values
        return {
            "friction": [friction, 0.0, 0.0],
            "condim": 3 if friction > 0.0 else 1,
            "solref": stiff_contact(dt, restitution),
        }

    def _new_spec(self, dt: float) -> Any:
        mujoco = self.mujoco
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        spec.compiler.boundmass = spec.compiler.boundinertia = _LEAST
        spec.option.timestep = dt
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.gravity = np.array(self._built.model.gravity.linear)
        return spec

    def _add_bodies(self, spec: Any, dt: float) -> list[Any]:
        """Add a body with its joint for each joint of the scene; return them by joint number, the world first."""
        model, bodies = self._built.model, [spec.worldbody]
        for i in range(1, model.njoints):
            place, inertia = model.jointPlacements[i], model.inertias[i]
            about, tensor, lever = _diagonal(inertia)
            body = bodies[model.parents[i]].add_body(
                name=model.names[i], pos=place.translation, quat=_quaternion(place.rotation), explicitinertial=True,
                mass=inertia.mass, ipos=lever, iquat=about, inertia=tensor,
            )  # fmt: skip
            bodies.append(body)
            self._add_joint(body, i, dt)
        return bodies

    def _add_joint(self, body: Any, i: int, dt: float) -> None:
        model, arrays, kinds = self._built.model, self._built.arrays, self.mujoco.mjtJoint
        joint, name = model.joints[i], model.names[i]
        if joint.nv == 6:
            body.add_freejoint(name=name)
            return
        if joint.nv != 1:
            raise InputError(
                "A MuJoCo model has no such joint",
                name=name,
                got=joint.shortname(),
                expected="a free joint, or one with one degree of freedom",
                remedy="Replace it by revolute and prismatic joints",
            )
        data = joint.createData()
        joint.calc(data, pin.neutral(model), np.zeros(model.nv))
        linear, angular = np.split(np.asarray(data.S).ravel(), 2)
        if np.any(linear) and np.any(angular):
            raise InputError(
                "A MuJoCo model has no screws",
                name=name,
                got=joint.shortname(),
                expected="a joint that turns or slides",
                remedy="Replace it by a revolute and a prismatic joint with an equality",
            )
        turns, v = bool(np.any(angular)), joint.idx_v
        settings: dict[str, Any] = {"damping": [model.damping[v], 0.0, 0.0], "armature": model.armature[v]}
        if arrays.limits[i]:
            bounds = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
            limit = stiff_contact(dt, float(arrays.limit_restitution[i]))
            settings |= {"limited": 1, "range": bounds, "solref_limit": limit}
        if arrays.stiffness[i]:
            settings |= {"stiffness": [arrays.stiffness[i], 0.0, 0.0], "springref": float(arrays.rest[joint.idx_q])}
        kind = kinds.mjJNT_HINGE if turns else kinds.mjJNT_SLIDE
        body.add_joint(name=name, type=kind, axis=angular if turns else linear, **settings)

    def _add_shapes(self, spec: Any, bodies: list[Any]) -> None:
        used = self._used()
        for k, item in enumerate(self._built.collision.geometryObjects):
            if k in used:
                kind = self._shape(spec, item)
                place = _frame_of(item)
                bodies[item.parentJoint].add_geom(
                    name=item.name, pos=place.translation, quat=_quaternion(place.rotation), **kind, **self._contact
                )

    def _shape(self, spec: Any, item: pin.GeometryObject) -> dict[str, Any]:
        kinds, shape = self.mujoco.mjtGeom, item.geometry
        if isinstance(shape, coal.Halfspace):
            return {"type": kinds.mjGEOM_PLANE, "size": [0.0, 0.0, 1.0]}
        if isinstance(shape, coal.Box):
            return {"type": kinds.mjGEOM_BOX, "size": np.array(shape.halfSide)}
        if isinstance(shape, coal.Sphere):
            return {"type": kinds.mjGEOM_SPHERE, "size": [shape.radius, 0.0, 0.0]}
        for own, kind in ((coal.Capsule, kinds.mjGEOM_CAPSULE), (coal.Cylinder, kinds.mjGEOM_CYLINDER)):
            if isinstance(shape, own):
                return {"type": kind, "size": [shape.radius, shape.halfLength, 0.0]}
        if isinstance(shape, coal.ConvexBase):
            points = np.array([shape.point(i) for i in range(shape.num_points)])
            convex = self.mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
            spec.add_mesh(name=item.name, uservert=points.ravel().tolist(), inertia=convex)
            return {"type": kinds.mjGEOM_MESH, "meshname": item.name}
        raise InputError(
            "A MuJoCo model has no such shape",
            name=item.name,
            got=type(shape).__name__,
            expected="a halfspace, box, sphere, capsule, cylinder or convex hull",
            remedy="Replace it by one of these shapes",
        )

    def _choose_pairs(self, spec: Any) -> None:
        """Let MuJoCo test what contactvi tests.

        MuJoCo tests all shapes of two bodies, unless they are neighbours or excluded. Where contactvi tests some of
        them only, or shapes of neighbours, the bodies are excluded and the pairs given one by one.
        """
        model, collision = self._built.model, self._built.collision
        names, items = ["world", *self._names], collision.geometryObjects
        tested: dict[tuple[int, int], list[tuple[int, int]]] = defaultdict(list)
        for pair in collision.collisionPairs:
            bodies = sorted((items[pair.first].parentJoint, items[pair.second].parentJoint))
            tested[bodies[0], bodies[1]].append((pair.first, pair.second))
        shapes = Counter(items[k].parentJoint for k in self._used())
        if all(len(pairs) == shapes[a] * shapes[b] for (a, b), pairs in tested.items()) and len(tested) == _all(shapes):
            return  # as in a heap
        for a, b in itertools.combinations(sorted(shapes), 2):
            pairs = tested.get((a, b), [])
            neighbours = a > 0 and model.parents[b] == a
            if len(pairs) == shapes[a] * shapes[b] and not neighbours:
                continue
            spec.add_exclude(bodyname1=names[a], bodyname2=names[b])
            for first, second in pairs:
                friction = 2 * [self._contact["friction"][0]] + 3 * [0.0]
                spec.add_pair(
                    geomname1=items[first].name, geomname2=items[second].name, condim=self._contact["condim"],
                    friction=friction, solref=self._contact["solref"],
                )  # fmt: skip

    def _used(self) -> set[int]:
        """Return the numbers of the shapes that are tested for contact."""
        return {index for pair in self._built.collision.collisionPairs for index in (pair.first, pair.second)}

    def _add_servos(self, spec: Any) -> list[str]:
        """Add position actuators; return the names of their joints."""
        names = self._built.servo_joints
        for name in names:
            v = self._built.model.joints[self._built.model.getJointId(name)].idx_v
            kp, kd, effort = (float(x) for x in self._built.arrays.servo[:, v])
            servo = spec.add_actuator(name=name, target=name, trntype=self.mujoco.mjtTrn.mjTRN_JOINT)
            servo.set_to_position(kp=kp, kv=kd)
            if math.isfinite(effort):
                servo.forcelimited, servo.forcerange = 1, [-effort, effort]
        return names


def _all(shapes: Counter[int]) -> int:
    """Return the number of pairs of bodies that have shapes."""
    return len(shapes) * (len(shapes) - 1) // 2


def _diagonal(inertia: pin.Inertia) -> tuple[Array, Array, Array]:
    """Return the principal axes as a quaternion w x y z, the principal moments and the centre of mass of an inertia."""
    moments, axes = np.linalg.eigh(np.asarray(inertia.inertia))
    axes = axes * np.sign(np.linalg.det(axes))
    return _quaternion(axes), np.maximum(moments, _LEAST), np.array(inertia.lever)


def _frame_of(item: pin.GeometryObject) -> pin.SE3:
    """Return the place of a shape in its body; of a halfspace that of its surface, the normal along z."""
    if not isinstance(item.geometry, coal.Halfspace):
        return item.placement
    normal, offset = np.array(item.geometry.n), float(item.geometry.d)
    helper = [1.0, 0.0, 0.0] if abs(normal[0]) < 0.9 else [0.0, 1.0, 0.0]
    tangent = np.cross(normal, helper)
    tangent /= np.linalg.norm(tangent)
    axes = np.column_stack([tangent, np.cross(normal, tangent), normal])
    return item.placement * pin.SE3(axes, offset * normal)


def _quaternion(rotation: Array) -> Array:
    """Return the quaternion w x y z of a rotation."""
    x, y, z, w = pin.Quaternion(np.asarray(rotation)).coeffs()
    return np.array([w, x, y, z])
