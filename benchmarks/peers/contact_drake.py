"""Scenes of contact_cases.py in Drake. setting: accuracy (continuous, with the integrator CENIC), or approximation (of
the discrete plant: sap, lagged, ...) and dt; stiffness of the contact [N/m], else as Drake has it.

Point contact, which has one point for a box on a plane: there its corners are small balls. In the discrete plant a
stiffness comes with a dissipation within one step. Servos are PD controlled actuators, which the discrete plant and
CENIC take implicitly. A motion is that of a mass of HEAVY on a spring. Loops are ball constraints, which the discrete
plant with SAP has alone.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import (
    AddContactMaterial,
    Box,
    CollisionFilterDeclaration,
    GeometrySet,
    HalfSpace,
    ProximityProperties,
    Sphere,
)
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    PdControllerGains,
    PrismaticJoint,
    PrismaticSpring,
    RevoluteJoint,
    RotationalInertia,
    SpatialInertia,
)
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Diagram, DiagramBuilder
from worker import Run

HEAVY = 1e6  # kg
LIGHT = 1e-6  # kg, of frames without mass, which CENIC refuses
CORNER = 5e-3  # radius of the balls at the corners of a box on a plane [m]
JOINTS = {"slide": PrismaticJoint, "hinge": RevoluteJoint}


def pose_of(given: dict[str, Any]) -> RigidTransform:
    return RigidTransform(RollPitchYaw(given.get("rpy", [0.0, 0.0, 0.0])), given.get("xyz", [0.0, 0.0, 0.0]))


def shape_of(given: dict[str, Any]) -> Any:
    if "sphere" in given:
        return Sphere(given["sphere"])
    return Box(*given["box"]) if "box" in given else HalfSpace()


def collisions(item: dict[str, Any], on_plane: bool) -> list[tuple[RigidTransform, Any]]:
    """The shapes of a body, with their places in it; a box on a plane is its corners, as small balls."""
    found = []
    for given in item["shapes"]:
        place = pose_of(given)
        if on_plane and "box" in given:
            half = 0.5 * np.array(given["box"]) - CORNER
            found += [(place @ RigidTransform(half * signs), Sphere(CORNER)) for signs in product((-1, 1), repeat=3)]
        else:
            found.append((place, shape_of(given)))
    return found


def inertia_of(item: dict[str, Any]) -> SpatialInertia:
    full = np.array(item["inertia"])
    about = RotationalInertia(full[0, 0], full[1, 1], full[2, 2], full[0, 1], full[0, 2], full[1, 2])
    mass = HEAVY if "motion" in item else item["mass"]
    if not mass:
        return SpatialInertia.SolidSphereWithMass(LIGHT, CORNER)
    return SpatialInertia.MakeFromCentralInertia(mass, item["com"], about)


def build(job: dict[str, Any], setting: dict[str, Any]) -> tuple[Diagram, MultibodyPlant]:
    config = MultibodyPlantConfig(time_step=setting.get("dt", 0.0), contact_model="point")
    if "dt" in setting:
        config.discrete_contact_approximation = setting["approximation"]
    builder = DiagramBuilder()
    plant, graph = AddMultibodyPlant(config, builder)
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -job["gravity"]])
    surface = ProximityProperties()
    stiffness = {"point_stiffness": setting["stiffness"]} if "stiffness" in setting else {}
    AddContactMaterial(friction=CoulombFriction(job["friction"], job["friction"]), properties=surface, **stiffness)
    if stiffness and "dt" in setting:
        surface.AddProperty("material", "relaxation_time", setting["dt"])
    planes = {item["name"] for item in job["bodies"] if any("plane" in shape for shape in item["shapes"])}
    on_plane = {second for first, second in job["pairs"] if first in planes}
    bodies = {"world": plant.world_body()}
    for item in job["bodies"]:
        name, parent = item["name"], bodies[item["parent"]]
        if item["joint"] == "fixed":
            bodies[name] = parent
        else:
            bodies[name] = plant.AddRigidBody(name, inertia_of(item))
        if item["joint"] in JOINTS:
            frame = FixedOffsetFrame(f"at {name}", parent.body_frame(), pose_of(item.get("pose", {})))
            kind, own = JOINTS[item["joint"]], bodies[name].body_frame()
            joint = plant.AddJoint(kind(name, plant.AddFrame(frame), own, item["axis"]))
            spring = HEAVY * item["motion"]["rate"] ** 2 if "motion" in item else item.get("stiffness")
            if spring:
                plant.AddForceElement(PrismaticSpring(joint, 0.0, spring))
            if "servo" in item:
                actuator = plant.AddJointActuator(name, joint)
                actuator.set_controller_gains(PdControllerGains(p=item["servo"]["kp"], d=item["servo"]["kd"]))
        for k, (place, shape) in enumerate(collisions(item, name in on_plane)):
            plant.RegisterCollisionGeometry(bodies[name], place, shape, f"{name}{k}", surface)
    for loop in job["loops"]:
        first, point = bodies[loop["a"]], loop["point_a"]
        if loop["a"] == "world":  # in Drake 1.51.1 a ball constraint with the world is a segmentation fault
            first, point = plant.AddRigidBody("mount", SpatialInertia.SolidSphereWithMass(1.0, CORNER)), [0.0, 0.0, 0.0]
            plant.WeldFrames(plant.world_frame(), first.body_frame(), RigidTransform(loop["point_a"]))
        plant.AddBallConstraint(first, point, bodies[loop["b"]], loop["point_b"])
    plant.Finalize()
    _filter(job, plant, graph, bodies)
    return builder.Build(), plant


def _filter(job: dict[str, Any], plant: MultibodyPlant, graph: Any, bodies: dict[str, Any]) -> None:
    """Let the shapes of the job's pairs touch, and no others."""
    seconds = {second for _, second in job["pairs"]}
    firsts = {first for first, _ in job["pairs"]}
    for names in (firsts, seconds):
        shapes = [s for name in names for s in plant.GetCollisionGeometriesForBody(bodies[name])]
        graph.collision_filter_manager().Apply(CollisionFilterDeclaration().ExcludeWithin(GeometrySet(shapes)))


def prepare(job: dict[str, Any], setting: dict[str, Any]) -> Run:
    diagram, plant = build(job, setting)
    simulator = Simulator(diagram)
    if "accuracy" in setting:
        ApplySimulatorConfig(SimulatorConfig(integration_scheme="cenic", accuracy=setting["accuracy"]), simulator)
    context = simulator.get_mutable_context()
    inside = plant.GetMyMutableContextFromRoot(context)
    served = [item for item in job["bodies"] if "servo" in item]
    if served:
        actuators = [plant.GetJointActuatorByName(item["name"]) for item in served]
        target = np.zeros(2 * len(served))  # positions, then speeds, in the actuators' order
        target[[actuator.input_start() for actuator in actuators]] = [item["servo"]["target"] for item in served]
        plant.get_desired_state_input_port(actuators[0].model_instance()).FixValue(inside, target)
    for name, value in job["start"]["q"].items():
        speed = job["start"]["v"][name]
        if np.ndim(value):
            body, turn = plant.GetBodyByName(name), np.array(value[3:])[[3, 0, 1, 2]]
            plant.SetFreeBodyPose(inside, body, RigidTransform(RotationMatrix(Quaternion(turn)), value[:3]))
            plant.SetFreeBodySpatialVelocity(body, SpatialVelocity(w=speed[3:], v=speed[:3]), inside)
        else:
            joint = plant.GetJointByName(name)
            state = plant.GetPositionsAndVelocities(inside).copy()
            state[joint.position_start()] = value
            state[plant.num_positions() + joint.velocity_start()] = speed
            plant.SetPositionsAndVelocities(inside, state)
    samples = np.arange(1, round(job["duration"] / job["sample"]) + 1) * job["sample"]
    seen = [(plant.GetBodyByName(name), np.array(point, dtype=float)) for name, point in job["observe"]]
    initial = context.Clone()

    def run() -> tuple[list, list]:
        context.SetTimeStateAndParametersFrom(initial)
        simulator.Initialize()
        rows = []
        for t in samples:
            simulator.AdvanceTo(t)
            rows.append(np.concatenate([plant.EvalBodyPoseInWorld(inside, body) @ point for body, point in seen]))
        return rows, []

    return run
