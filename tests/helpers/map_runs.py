"""Runs of the three impact maps on the engine, below the Python API, the oracle's impacts, and scenes to run."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from types import SimpleNamespace

import coal
import numpy as np
import pinocchio as pin

from batteries.models import Builder, case
from contactvi.records import events as event_log
from helpers.contact_models import geometry, halfspace, place
from helpers.engine import simulator
from helpers.run_scenes import HAND_URDF
from oracles import ctec_oracle, dtec_mhc
from oracles.del_step import System
from oracles.modified_energy import modified_energy

METHODS = ("ctec", "dtec", "mhc")


def start(scene, q, v, h: float, method: str, mhc_global: bool = False, **options):
    """The engine's simulator, set to (q, v) at t = 0."""
    from contactvi import _core

    reference = _core.MhcReference.GLOBAL if mhc_global else _core.MhcReference.LOCAL
    found = simulator(scene.core(), h, impact=_core.ImpactMap[method.upper()], mhc_reference=reference, **options)
    status = found.reset(np.asarray(q, float), np.asarray(v, float), 0.0)
    assert status["code"] == 0, status["message"]
    return found


def run(scene, q, v, duration: float, h: float, method: str, every: int = 1, **options) -> SimpleNamespace:
    """Nodes t, q, p, events (list and arrays `log`), code, message and stats of a run of the engine from (q, v)."""
    result = start(scene, q, v, h, method, **options).advance(max(1, round(duration / h)), None, every, None)
    found = result.pop("events")
    log = event_log.joined([] if found is None else [found], scene.nq, scene.nv)
    events = [SimpleNamespace(**{k: a[i] for k, a in log.items()}) for i in range(len(log["time"]))]
    return SimpleNamespace(**result, events=events, log=log, h=h, method=method)


def by_step(events: list) -> Iterator[list]:
    """The events of each step that has some."""
    for _, group in itertools.groupby(events, key=lambda e: e.step):
        yield list(group)


def gradient_of(scene) -> Callable:
    """W (nv,) of an event: pin's Jacobians at the engine's contact point."""
    model, shapes, pairs = scene.model, scene.collision_model, scene.pair_names

    def gradient(event) -> np.ndarray:
        a, b = (shapes.geometryObjects[shapes.getGeometryId(n)].parentJoint for n in pairs[event.index])
        return ctec_oracle.point_gradient(model, event.q, a, event.point, b, event.point, event.normal)

    return gradient


def oracle_impacts(system: System, result: SimpleNamespace, gradient: Callable) -> Iterator[tuple]:
    """(event, the oracle's impact) of a DTEC or MHC run recorded at every node.

    Several impacts in one step: MHC's reference is that of the start of the step less the losses since, DTEC's the
    partial step between the impacts.
    """
    for group in by_step(result.events):
        node = int(group[0].step)
        reference = modified_energy(system, result.q[node], result.p[node], result.h)
        for e in group:
            w = gradient(e)
            if result.method == "mhc":
                hit = dtec_mhc.mhc(system, e.q, e.p_minus, w, e.restitution, float(e.after), result.h, reference)
                reference -= hit.loss
            else:
                hit = dtec_mhc.dtec(system, e.q, e.p_minus, w, e.restitution, float(e.before), float(e.after))
            yield e, hit


# --- scenes: (model, geometry, q0, v0, duration, h) -----------------------------------------------------------------
def two_bodies(gravity: bool = False, ratio: float = 1.0):
    """Two free bodies with centres of mass off their shapes' centres, flying at each other, spinning."""
    b = Builder(5)
    for _ in range(2):
        b.add("free_flyer", placement=pin.SE3.Identity())
    model = b.model
    model.inertias[2] = pin.Inertia(
        ratio * model.inertias[2].mass, model.inertias[2].lever, ratio * model.inertias[2].inertia
    )
    if not gravity:
        model.gravity = pin.Motion.Zero()
    shapes = {"ball": (1, place(0.05), coal.Sphere(0.2)), "capsule": (2, place(0.0, 0.05), coal.Capsule(0.15, 0.3))}
    q, v = pin.neutral(model), np.zeros(12)
    q[7:10] = 0.9, 0.05, -0.1
    q[10:14] = pin.Quaternion(pin.exp3(np.array([0.3, -0.5, 0.2]))).coeffs()
    v[:6], v[6:9] = [1.5, 0.1, 0.0, 2.0, -3.0, 1.0], pin.Quaternion(q[10:14]).matrix().T @ [-1.0, 0.0, 0.0]
    v[9:] = -1.0, 2.0, 1.5
    return model, geometry(shapes, [("ball", "capsule")]), q, v, 0.6, 0.02


def body_at_wall(half: float = 0.5):
    """A ball whose centre of mass is off its centre, spinning, between two walls 2 `half` [m] apart, with gravity."""
    b = Builder(6)
    b.add("free_flyer", placement=pin.SE3.Identity())
    walls = {f"wall{s}": (0, pin.SE3.Identity(), halfspace(0.0, 0.0, s, -half)) for s in (-1, 1)}
    shapes = {"ball": (1, place(0.03, -0.02, 0.04), coal.Sphere(0.2)), **walls}
    v = np.array([0.2, 0.3, -2.0, 3.0, -2.0, 1.0])
    return b.model, geometry(shapes, [(w, "ball") for w in walls]), pin.neutral(b.model), v, 1.0, 0.02


def arm_at_wall():
    """An arm with a spherical joint and armature whose hand swings at a wall."""
    model = case("arm_spherical").model()
    q, v = case("arm_spherical").state(model)
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    low = data.oMi[4].translation[2] - 0.35
    shapes = {"hand": (4, pin.SE3.Identity(), coal.Sphere(0.2)), "wall": (0, place(), halfspace(0.0, 0.0, 1.0, low))}
    return model, geometry(shapes, [("wall", "hand")]), q, 2.0 * v, 1.0, 0.02


def hand_and_ball():
    """(scene, system, q0): the Allegro hand (16 dof), palm up, kept half closed by springs, and a ball falling on it.

    The first impact is on a finger, the next on the palm within two steps of 2e-3 s. No damping: both scalars are then
    constants of the motion.
    """
    import contactvi as cvi

    scene = cvi.Scene()
    scene.add_urdf(HAND_URDF, placement=((0.0, 0.0, 0.1), (0.0, -np.pi / 2, 0.0)))
    scene.add_sphere("ball", radius=0.03, mass=0.1, placement=(0.03, 0.0, 0.2))
    scene.set_contact(restitution=0.7)
    pose = {"joint_*": 0.6, "joint_0.0": 0.0, "joint_4.0": 0.0, "joint_8.0": 0.0, "joint_12.0": 1.0}
    for name, angle in pose.items():
        scene.set_joint(name, stiffness=1.0, rest=angle, damping=0.0)
    stiffness = np.array([0.0] + [1.0] * 16 + [0.0])
    return scene, System(scene.model, stiffness, scene.spring_rest()), scene.configuration(pose)
