"""The engine's constant scene: made of a complete model, joint arrays and elements; asked for states and points.

Models cross to C++ as numbers, shapes by the addresses of coal's objects, of which the engine makes copies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pinocchio as pin

from contactvi.elements.user_functions import checked_force, checked_force_derivatives, checked_of_q
from contactvi.errors import SceneError
from contactvi.importing.engine_model import engine_model
from contactvi.importing.given_surfaces import GivenSurface
from contactvi.scene.contact_functions import ContactFunction
from contactvi.scene.contact_laws import PairLaw
from contactvi.scene.element_rows import Resolved
from contactvi.scene.joint_arrays import JointArrays
from contactvi.scene.rounded_hulls import RoundedHulls
from contactvi.scene.surface_motion import SurfaceMotion

if TYPE_CHECKING:
    from contactvi import _core

EngineScene: TypeAlias = "_core.Scene"
ImpactsAt: TypeAlias = "_core.ImpactsAt"
# The joint of a geometry, its rotation (3, 3) and position (3,) there, its name and the address of its shape.
Shape: TypeAlias = tuple[int, np.ndarray, np.ndarray, str, int]


def make_engine_scene(
    model: pin.Model,
    collision: pin.GeometryModel,
    pairs: np.ndarray,
    restitution: np.ndarray,
    friction: np.ndarray,
    laws: Sequence[tuple[PairLaw, list[int]]],
    motions: Mapping[str, SurfaceMotion],
    arrays: JointArrays,
    elements: Resolved,
    surfaces: Mapping[str, GivenSurface],
) -> EngineScene:
    """Return the engine's scene.

    Args:
        model, collision: The complete model and its geometry.
        pairs: Geometries of the tested pairs, int32 of shape (npairs, 2).
        restitution, friction: Of the tested pairs, shapes (npairs,).
        laws: Laws of contact, each with the places of its pairs.
        motions: Of surfaces that move along themselves, by the names of their geometries.
        surfaces: Surfaces given by functions, by the names of their geometries.

    Raises:
        EngineError: The engine refuses it.
        SceneError: There is no memory for it.
    """
    from contactvi import _core

    try:
        scene = _core.Scene(
            engine_model(model),
            shapes_by_address(collision),
            pairs,
            restitution,
            friction,
            arrays.stiffness,
            arrays.rest,
            np.asarray(model.damping),
            arrays.limits,
            arrays.limit_restitution,
            RoundedHulls(),
        )
        adhesive = list(dict.fromkeys(adhesion for law, _ in laws for adhesion in law.adhesive))
        for adhesion in adhesive:
            scene.add_body_pull(adhesion.pull.engine(adhesion.name))
        numbers: dict[int, int] = {}  # of functions that several laws share

        def added(function: ContactFunction) -> int:
            if id(function) not in numbers:
                numbers[id(function)] = function.added(scene)
            return numbers[id(function)]

        for law, places in laws:
            pulls = [adhesive.index(adhesion) for adhesion in law.adhesive]
            # An axis of friction is the first geometry's in some pairs and the second one's in others.
            for group in [places] if law.friction_axis is None else [[place] for place in places]:
                a, b = (collision.geometryObjects[int(k)].name for k in pairs[group[0]])
                scene.set_contact_law(group, **law.engine((a, b), added), body_pulls=pulls)
        for name, surface in surfaces.items():
            number = collision.getGeometryId(name)
            surface.put(scene, number, name)
        for name, motion in motions.items():
            scene.set_surface_motion(int(collision.getGeometryId(name)), *motion.engine(name))
        _set_joints(scene, arrays)
        _add_elements(scene, elements)
        _set_actuation(scene, arrays)
    except MemoryError:
        raise SceneError(
            "The scene does not fit into the memory",
            expected=f"memory for {model.nv} degrees of freedom and {len(pairs)} pairs",
            got="none left",
            remedy="Take pairs out with scene.disable_pair(...), or simplify the meshes",
        ) from None
    return scene


def _set_joints(scene: EngineScene, arrays: JointArrays) -> None:
    """Hand joint friction and nonlinear springs to the engine's scene."""
    if np.any(arrays.joint_friction):
        scene.set_joint_friction(arrays.joint_friction)
    for joint, rest, torque in arrays.polynomials:  # The torque -k_i x^i has the potential k_i x^(i + 1) / (i + 1).
        scene.add_joint_potential(joint, rest, torque / np.arange(2.0, len(torque) + 2.0))


def _add_elements(scene: EngineScene, elements: Resolved) -> None:
    """Hand springs, compliant pairs, wrenches, functions of the user and constraints to the engine's scene."""
    from contactvi import _core

    places: dict[int, int] = {}  # of functions that several pairs share
    for k, soft in enumerate(elements.compliances):
        law = soft.law
        numbers = (law.stiffness, law.exponent, law.damping, law.friction or 0.0, law.slip_speed)
        shared = [-1, -1, -1]
        for j, given in enumerate((law.force, law.energy, law.bound)):
            if given is not None:
                if id(given) not in places:
                    places[id(given)] = given.put(scene, soft.names)
                shared[j] = places[id(given)]
        scene.add_compliance(k, soft.a, soft.b, *soft.names, *numbers, functions=shared)
    for spring in elements.springs:
        scene.add_path_spring(*spring)
    for wrench in elements.wrenches:
        scene.add_wrench(*wrench)
    for force in elements.forces:
        derivatives: Any = force.derivatives
        if derivatives is not None:
            derivatives = checked_force_derivatives(derivatives, f"the derivatives of {force.name!r}", elements.dofs)
        scene.add_user_force(checked_force(force.function, repr(force.name), elements.dofs), derivatives)
    for potential in elements.potentials:
        functions = [(potential.value, "value"), (potential.gradient, "gradient"), (potential.hessian, "hessian")]
        checked: list[Any] = [
            None if function is None else checked_of_q(function, f"{what} of {potential.name!r}", elements.dofs, axes)
            for axes, (function, what) in enumerate(functions)
        ]
        scene.add_user_potential(*checked)
    for row in elements.constraints:
        if row.pose is not None:
            scene.add_prescribed_pose(*row.b, row.pose, row.name)
            continue
        kind = _core.ConstraintKind[row.engine_kind.upper()]
        scene.add_constraint(kind, *row.a, *row.b, row.numbers, row.signal, row.name, row.coupled)
    if elements.couplings.followers:
        rows = [(f.joint, f.offset, [(f.leader, f.ratio)]) for f in elements.couplings.followers]
        scene.couple_joints(rows, elements.couplings.lent)


def _set_actuation(scene: EngineScene, arrays: JointArrays) -> None:
    """Hand servos and actuator limits to the engine's scene."""
    if np.any(arrays.servo[:2]):
        scene.set_servo(*(np.ascontiguousarray(part) for part in arrays.servo))
    if np.any(np.isfinite(arrays.actuator)):
        scene.set_actuator_limits(*(np.ascontiguousarray(part) for part in arrays.actuator))


def static_trees(scene: EngineScene) -> _core.StaticTrees:
    """Return the trees of a scene that nothing but contacts couples."""
    from contactvi import _core

    return _core.StaticTrees(scene)


def engine_states(
    scene: EngineScene,
    segments: Mapping[str, np.ndarray],
    times: np.ndarray,
    order: int,
    tol: float,
    exact: bool,
    momenta: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Return q (N, nq), v (N, nv) at times [s] from segments of a run (contactvi.trajectory.polynomials).

    Args:
        tol: Of the stage equations of partial steps.
        exact: By partial steps, for runs without inputs, where no contact persists and where the polynomials leave out
            more than tol; else from these.
        momenta: p instead of v, which needs `exact`.
    """
    from contactvi import _core

    q, v = _core.dense(scene, dict(segments), times, order, tol, exact, momenta)
    return np.asarray(q), np.asarray(v)


def engine_contact_points(scene: EngineScene, q: np.ndarray, pair: int, margin: float) -> dict[str, Any]:
    """Return the points of a pair with gaps of at most margin [m] at q (nq,), at most four.

    "feature": list of their numbers; "gap" (n,); "point_a", "point_b", "normal" (n, 3), world frame.
    """
    from contactvi import _core

    return _core.contact_points(scene, q, pair, margin)


def engine_compliant_contacts(scene: EngineScene, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the compliant contacts that overlap at states (n, nq), (n, nv).

    The numbers of state and pair, (m, 2), and depth, normal, point and force on the second shape, (m, 10), world frame.
    """
    numbers, values = scene.compliant_contacts(q, v)
    return np.asarray(numbers), np.asarray(values)


def engine_passive_forces(scene: EngineScene, q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
    """Return the forces of springs, dampers and elements, (nv,), at q (nq,), v (nv,), t [s]."""
    from contactvi import _core

    return np.asarray(_core.passive_forces(scene, q, v, t))


def engine_impacts(
    scene: EngineScene, q: np.ndarray, guards: Sequence[int], restitution: np.ndarray, margin: float, max_impacts: int
) -> ImpactsAt:
    """Return the frictionless impacts that are possible at q of these guards, taken as closed whatever their gaps are.

    Args:
        q: Configuration, shape (nq,).
        guards: Numbers of pairs, then of joint limits.
        restitution: Of each guard.
        margin: A pair's points within this [m], or within its gap where that is more, belong to its contact.
        max_impacts: Number of impacts after which a sequence is endless.
    """
    from contactvi import _core

    return _core.ImpactsAt(scene, q, list(guards), restitution, margin, max_impacts)


def shapes_by_address(collision: pin.GeometryModel) -> list[Shape]:
    """Return the geometries as the engine's scene takes them; the model has to live until it is made."""
    return [
        (
            int(item.parentJoint), item.placement.rotation, item.placement.translation,
            str(item.name), int(item.geometry.id()),
        )
        for item in collision.geometryObjects
    ]  # fmt: skip
