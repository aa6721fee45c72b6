"""S7 in Drake. setting: approximation (of the discrete plant: sap, lagged, ...) and dt, or integrator (continuous,
error controlled) and accuracy; stiff: contacts of 1e9 N/m (SAP then takes the stiffest it can resolve) and dissipation
within one step, else as Drake has them.

The controllers are PD controlled actuators, which the discrete plant takes implicitly, effort limits included. Point
contact; the hand does not touch itself, by a collision filter.
"""

from __future__ import annotations

import numpy as np
from pydrake.geometry import (
    AddContactMaterial,
    Box,
    CollisionFilterDeclaration,
    GeometrySet,
    ProximityProperties,
    Sphere,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import PdControllerGains, SpatialInertia, UnitInertia
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from worker import Run

STIFF = 1e9  # N/m


def build(job: dict, setting: dict) -> tuple[Diagram, MultibodyPlant]:
    config = MultibodyPlantConfig(time_step=setting.get("dt", 0.0), contact_model="point")
    if "dt" in setting:
        config.discrete_contact_approximation = setting["approximation"]
    builder, ball = DiagramBuilder(), job["ball"]
    plant, graph = AddMultibodyPlant(config, builder)
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -job["gravity"]])
    hand = Parser(plant).AddModelsFromString(job["urdf"], "urdf")[0]
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    surface = ProximityProperties()
    stiffness = {"point_stiffness": STIFF} if setting.get("stiff") else {}
    AddContactMaterial(friction=CoulombFriction(job["friction"], job["friction"]), properties=surface, **stiffness)
    if setting.get("stiff"):
        surface.AddProperty("material", "relaxation_time", setting["dt"])
    bodies = [plant.GetBodyByName("base"), *(plant.GetBodyByName(f"L{k + 1}") for k in range(len(job["joints"])))]
    for k, shape in enumerate(job["shapes"]):
        solid = Box(*shape["box"]) if "box" in shape else Sphere(shape["sphere"])
        place = RigidTransform(RollPitchYaw(shape["rpy"]), shape["xyz"])
        plant.RegisterCollisionGeometry(bodies[shape["joint"]], place, solid, f"shape{k}", surface)
    for name in job["joints"]:
        actuator = plant.AddJointActuator(name, plant.GetJointByName(name), job["effort"])
        actuator.set_controller_gains(PdControllerGains(p=job["kp"], d=job["kd"]))
    inertia = SpatialInertia(ball["mass"], np.zeros(3), UnitInertia.SolidSphere(ball["radius"]))
    body = plant.AddRigidBody("ball", plant.AddModelInstance("ball"), inertia)
    plant.RegisterCollisionGeometry(body, RigidTransform(), Sphere(ball["radius"]), "ball", surface)
    plant.Finalize()
    shapes = GeometrySet([shape for body in bodies for shape in plant.GetCollisionGeometriesForBody(body)])
    graph.collision_filter_manager().Apply(CollisionFilterDeclaration().ExcludeWithin(shapes))
    diagram = builder.Build()
    assert plant.num_actuated_dofs(hand) == len(job["joints"])
    return diagram, plant


def prepare(job: dict, setting: dict) -> Run:
    diagram, plant = build(job, setting)
    simulator = Simulator(diagram)
    if "accuracy" in setting:
        ResetIntegratorFromFlags(simulator, setting["integrator"], 0.1)
        simulator.get_mutable_integrator().set_fixed_step_mode(False)
        simulator.get_mutable_integrator().set_target_accuracy(setting["accuracy"])
    context = simulator.get_mutable_context()
    inside = plant.GetMyMutableContextFromRoot(context)
    joints, ball = [plant.GetJointByName(name) for name in job["joints"]], plant.GetBodyByName("ball")
    at_q, at_v = [j.position_start() for j in joints], [j.velocity_start() for j in joints]
    actuators = [plant.GetJointActuatorByName(name) for name in job["joints"]]
    target = np.zeros(2 * len(joints))  # positions, then speeds, in the actuators' order
    target[[actuator.input_start() for actuator in actuators]] = job["goal"]
    plant.get_desired_state_input_port(joints[0].model_instance()).FixValue(inside, target)
    samples = np.arange(1, round(job["duration"] / job["sample"]) + 1) * job["sample"]
    start = setting.get("start", job["start"])
    place, speed = RigidTransform(start["q"][16:]), SpatialVelocity(w=start["v"][19:], v=start["v"][16:19])
    initial = context.Clone()

    def run() -> tuple[list, list]:
        context.SetTimeStateAndParametersFrom(initial)
        q, v = plant.GetPositions(inside).copy(), plant.GetVelocities(inside).copy()
        q[at_q], v[at_v] = start["q"][:16], start["v"][:16]
        plant.SetPositions(inside, q)
        plant.SetVelocities(inside, v)
        plant.SetFreeBodyPose(inside, ball, place)
        plant.SetFreeBodySpatialVelocity(ball, speed, inside)
        simulator.Initialize()
        out: tuple[list, list] = ([], [])
        for t in samples:
            simulator.AdvanceTo(t)
            pose, twist = plant.EvalBodyPoseInWorld(inside, ball), plant.EvalBodySpatialVelocityInWorld(inside, ball)
            out[0].append(np.concatenate([plant.GetPositions(inside)[at_q], pose.translation()]))
            speeds = plant.GetVelocities(inside)[at_v]
            out[1].append(np.concatenate([speeds, twist.translational(), twist.rotational()]))
        return out

    return run
