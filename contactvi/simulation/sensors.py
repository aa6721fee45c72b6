"""Sensors of a `Simulator`: what is measured after a step, mean values over that step where forces are concerned.

The step is the last call of `Simulator.step`. After `Simulator.run` it is what lies between the last two recorded
nodes: the last step, or with record_every=k the last k. Impacts within it count with their impulses: divided by the
length of the step, as a sensor that integrates would show them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.errors import InputError, SimulationError
from contactvi.html import html_fields
from contactvi.importing.kinematics import JointChains
from contactvi.inputs import pose
from contactvi.records.codes import GuardKind
from contactvi.simulation.simulator import Simulator

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class EncoderReading:
    """q, v : value and velocity of a joint, shapes (nq,), (nv,) of the joint [rad, m; rad/s, m/s]."""

    q: Array
    v: Array


@dataclass(frozen=True, eq=False)
class ImuReading:
    """Of an IMU, in its own axes, shapes (3,): specific_force [m/s^2], angular_velocity [rad/s]."""

    specific_force: Array
    angular_velocity: Array


@dataclass(frozen=True, eq=False)
class ContactReading:
    """What contacts do to a body, world axes, shapes (3,): force [N], torque [N m] about the body's origin now.

    Attributes:
        points: how many points took part, those of impacts included.
    """

    force: Array
    torque: Array
    points: int


class _Sensor(ABC):
    """What sensors show of themselves: where they are, and what they read now, if they can.

    Attributes:
        where: the joint or body that they are on.
    """

    _simulator: Simulator
    where: str

    @abstractmethod
    def _shown(self) -> dict[str, str]:
        """Return what the sensor shows now, by name, with units; raises SimulationError before there is something."""

    def __repr__(self) -> str:
        name = type(self).__name__
        try:
            read = ", ".join(f"{what} {value}" for what, value in self._shown().items())
            return f"<{name} on {self.where!r} at t = {self._simulator.t:.9g} s: {read}>"
        except SimulationError:
            return f"<{name} on {self.where!r}: nothing to read before the first step>"

    def _repr_html_(self) -> str:
        """Return what a notebook shows: what the sensor reads now."""
        title = f"{type(self).__name__} on {self.where}"
        try:
            return html_fields(title, {"t": f"{self._simulator.t:.9g} s", **self._shown()})
        except SimulationError:
            return html_fields(title, {"reads": "nothing before the first step"})


def _numbers(values: Array, unit: str) -> str:
    return "(" + ", ".join(f"{value:.6g}" for value in values) + f") {unit}"


class JointEncoder(_Sensor):
    """Reads a joint's value and velocity at the present time: JointEncoder(sim, "elbow").read()."""

    def __init__(self, simulator: Simulator, joint: Any) -> None:
        scene = _checked(simulator).scene
        self._simulator = simulator
        self.where = scene.names.select_joint(joint)
        self._q, self._v = scene.q_index(joint), scene.v_index(joint)

    def read(self) -> EncoderReading:
        """Return what it shows now."""
        return EncoderReading(self._simulator.q[self._q], self._simulator.v[self._v])

    def _shown(self) -> dict[str, str]:
        found = self.read()
        return {"q": _numbers(found.q, "rad or m"), "v": _numbers(found.v, "rad/s or m/s")}


class Imu(_Sensor):
    """Accelerometer and gyroscope on a body: Imu(sim, "torso", placement).read().

    Attributes:
        placement: of the sensor in the body's frame, as in Scene.add_urdf.

    The specific force is the mean of R^T (dv/dt - g) over the last step, v the velocity of the sensor's origin, impacts
    included: the change of v over the step, less g times its length, divided by it, in the axes that the sensor has in
    the middle of the step. At rest it is 9.81 m/s^2 upwards, in free fall zero. The angular velocity is that at the end
    of the step.
    """

    def __init__(self, simulator: Simulator, body: Any, placement: Any = None) -> None:
        self._simulator = _checked(simulator)
        self._model: pin.Model = simulator.scene.model
        self.where = simulator.scene.names.select_body(body)
        joint, place = _frame(simulator, body)
        self._joint, self._place = np.array([joint], dtype=np.int64), place * pose("placement", placement)

    def read(self) -> ImuReading:
        """Return what it shows now. Raises SimulationError before the first step."""
        sim = self._simulator
        t0, q0, v0 = sim.last_step()
        q1, h = sim.q, sim.t - t0
        before, _, _ = self._motion(q0, v0)
        after, angular, end = self._motion(q1, sim.v)
        _, _, middle = self._motion(pin.interpolate(self._model, q0, q1, 0.5), np.zeros(self._model.nv))
        force = (after - before) / h - self._model.gravity.linear
        return ImuReading(middle.T @ force, end.T @ angular)

    def _shown(self) -> dict[str, str]:
        found = self.read()
        return {
            "specific force": _numbers(found.specific_force, "m/s²"),
            "angular velocity": _numbers(found.angular_velocity, "rad/s"),
        }

    def _motion(self, q: Array, v: Array) -> tuple[Array, Array, Array]:
        """Return velocity and angular velocity of the sensor in world axes and its axes in the world."""
        (R,), _, (motion,) = map(np.asarray, self._simulator.scene.built().engine.model.motions(self._joint, q, v))
        velocity, spin = motion[0].reshape(2, 3)  # of the joint's origin, in the joint's axes
        return R @ (velocity + np.cross(spin, self._place.translation)), R @ spin, R @ self._place.rotation


class ContactSensor(_Sensor):
    """Contact force and torque on a body, the mean over the last step: ContactSensor(sim, "foot").read().

    All shapes of the body count; joint limits do not. Needs a simulator with record_contacts=True (the default).
    """

    def __init__(self, simulator: Simulator, body: Any) -> None:
        if not _checked(simulator).options.record_contacts:
            raise InputError(
                "Contacts are not recorded", name="record_contacts", expected="True", got="False",
                remedy="Make the simulator with record_contacts=True",
            )  # fmt: skip
        self._simulator = simulator
        self._joint, self._place = _frame(simulator, body)
        built = simulator.scene.built()
        name = self.where = simulator.scene.names.select_body(body)
        frames = {k for k, frame in enumerate(built.model.frames) if frame.name == name}
        shapes = {g.name for g in built.collision.geometryObjects if g.parentFrame in frames}
        if not shapes:
            raise InputError(
                f"Body {name!r} has no shape",
                name="body",
                expected="a body with collision geometry",
                got="none",
                remedy="Name the body that carries the shape, or add a shape to its model",
            )
        self._signs = np.array([(b in shapes) * 1.0 - (a in shapes) * 1.0 for a, b in built.pairs] or [0.0])

    def read(self) -> ContactReading:
        """Return what it shows now. Raises SimulationError before the first step."""
        sim = self._simulator
        start = sim.last_step()[0]
        log = sim.last_contacts()
        of_pair = log.array("kind") == GuardKind.CONTACT
        signs = np.where(of_pair, self._signs[np.where(of_pair, log.array("index"), 0)], 0.0)
        chosen = np.flatnonzero(signs)
        impulse = signs[chosen, None] * log.impulse[chosen]
        origin = self._origin()
        moment = np.cross(log.position[chosen] - origin, impulse)
        h = sim.t - start
        return ContactReading(impulse.sum(axis=0) / h, moment.sum(axis=0) / h, len(chosen))

    def _shown(self) -> dict[str, str]:
        found = self.read()
        return {
            "force": _numbers(found.force, "N"), "torque": _numbers(found.torque, "N m"), "points": str(found.points)
        }  # fmt: skip

    def _origin(self) -> Array:
        model = self._simulator.scene.model
        place = pin.XYZQUATToSE3(JointChains(model, [self._joint]).poses(self._simulator.q)[0])
        return np.array((place * self._place).translation)


def _checked(simulator: Any) -> Simulator:
    if not isinstance(simulator, Simulator):
        got = type(simulator).__name__
        raise InputError(
            "What a sensor reads",
            name="simulator",
            expected="a contactvi.Simulator",
            got=got,
            remedy="Make one: contactvi.Simulator(scene, dt=1e-3, record_contacts=True)",
        )
    return simulator


def _frame(simulator: Simulator, body: Any) -> tuple[int, pin.SE3]:
    """Return the joint that carries a body, and the body's placement in its frame."""
    name = simulator.scene.names.select_body(body)
    model = simulator.scene.model
    if name == "world":
        return 0, pin.SE3.Identity()
    frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
    return int(frame.parentJoint), frame.placement.copy()
