"""Drake. setting: integrator (continuous, error controlled), accuracy; with contacts stiffness [N/m].

Point contact is stiffness * depth * (1 + dissipation * speed): elastic without dissipation. For a smaller restitution
the dissipation is right at the speed of the first impact only, because it depends on that speed. S7:
hand_drake.py, lasting contact: contact_drake.py.

Mimic joints are coupler constraints, which the discrete plant with SAP has (setting: dt), and CENIC (integrator,
accuracy); the other integrators refuse constraints.
"""

from __future__ import annotations

import math

import contact_drake
import hand_drake
import numpy as np
from pydrake.geometry import AddContactMaterial, HalfSpace, ProximityProperties, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    CoulombFriction,
    DiscreteContactApproximation,
    MultibodyPlant,
    MultibodyPlantConfig,
)
from pydrake.systems.analysis import ApplySimulatorConfig, ResetIntegratorFromFlags, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from worker import Run, measure, without_shapes

FIRST_SPEED = 3.860525  # of S4's first impact [m/s], from the reference


def dissipation(restitution: float) -> float:
    """d with ln((1 + d v) / (1 - d e v)) = d v (1 + e) at v = FIRST_SPEED; by bisection."""
    if restitution >= 1.0:
        return 0.0
    low, high = 1e-6, 1.0 / restitution - 1e-9
    for _ in range(200):
        x = 0.5 * (low + high)
        short = math.log((1.0 + x) / (1.0 - x * restitution)) < x * (1.0 + restitution)
        low, high = (x, high) if short else (low, x)
    return low / FIRST_SPEED


def prepare(job: dict, setting: dict) -> Run:
    if job["name"] == "S7":
        return hand_drake.prepare(job, setting)
    if job["name"].startswith("contact "):
        return contact_drake.prepare(job, setting)
    config = MultibodyPlantConfig(time_step=setting.get("dt", 0.0), contact_model="point")
    builder, cenic = DiagramBuilder(), setting.get("integrator") == "cenic"
    # Without contacts a plant of its own is faster than one with a scene graph, which CENIC asks for.
    with_graph = job["balls"] or cenic
    plant = AddMultibodyPlant(config, builder)[0] if with_graph else builder.AddSystem(MultibodyPlant(config.time_step))
    if "dt" in setting:
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -job["gravity"]])
    Parser(plant).AddModelsFromString(without_shapes(job["urdf"]), "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))

    def add(body, pose, shape, name):
        surface = ProximityProperties()
        AddContactMaterial(dissipation=dissipation(job["restitution"]), point_stiffness=setting["stiffness"],
                           friction=CoulombFriction(0.0, 0.0), properties=surface)  # fmt: skip
        plant.RegisterCollisionGeometry(body, pose, shape, name, surface)

    for ball in job["balls"]:
        body = plant.GetBodyByName(f"L{ball['joint']}")
        add(body, RigidTransform(ball["centre"]), Sphere(ball["radius"]), f"ball{ball['joint']}")
    if job["wall"] is not None:
        pose = RigidTransform(RotationMatrix.MakeYRotation(-math.pi / 2), [job["wall"], 0.0, 0.0])
        add(plant.world_body(), pose, HalfSpace(), "wall")
    if job["floor"]:
        add(plant.world_body(), RigidTransform(), HalfSpace(), "floor")
    plant.Finalize()
    simulator = Simulator(builder.Build())
    if cenic:
        ApplySimulatorConfig(SimulatorConfig(integration_scheme="cenic", accuracy=setting["accuracy"]), simulator)
    elif "accuracy" in setting:
        ResetIntegratorFromFlags(simulator, setting["integrator"], 0.1)
        simulator.get_mutable_integrator().set_fixed_step_mode(False)
        simulator.get_mutable_integrator().set_target_accuracy(setting["accuracy"])
    context = simulator.get_mutable_context()
    plant_context = plant.GetMyMutableContextFromRoot(context)
    joints = [plant.GetJointByName(name) for name in job["joints"]]
    at_q, at_v = [j.position_start() for j in joints], [j.velocity_start() for j in joints]
    samples = np.arange(1, round(job["duration"] / job["sample"]) + 1) * job["sample"]
    initial = context.Clone()

    def run() -> tuple[list, list]:
        context.SetTimeStateAndParametersFrom(initial)
        q, v = np.zeros(len(joints)), np.zeros(len(joints))
        q[at_q], v[at_v] = job["q0"], job["v0"]
        plant.SetPositions(plant_context, q)
        plant.SetVelocities(plant_context, v)
        simulator.Initialize()
        out: tuple[list, list] = ([], [])
        for t in samples:
            simulator.AdvanceTo(t)
            out[0].append(plant.GetPositions(plant_context)[at_q])
            out[1].append(plant.GetVelocities(plant_context)[at_v])
        return out

    return run


if __name__ == "__main__":
    measure(prepare)
