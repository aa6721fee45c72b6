"""Pose signals: prescribed motions of a frame in the world, as pose and velocity.

A pose signal is given as

- a placement: constant;
- a table (times, poses): positions go along the cubic spline through them, as those of a `Signal`, rotations along a
  cubic spline on SO(3), both twice continuously differentiable. From one pose to the next it turns the shorter way;
  poses less than half a turn apart are needed. It ends as the table of a `Signal` does;
- a function t -> pose, or (pose, velocity). A velocity that is missing follows from differences of five points, up to
  0.2 ms around t; of a smooth function it is good to about 1e-11 of its size.

A pose is what `contactvi.inputs.pose` takes: pin.SE3, (xyz, quaternion xyzw), 7 numbers, (xyz, rpy), ... [m, rad]. A
velocity is (linear, angular), 6 numbers or pin.Motion: velocity of the frame's origin and angular velocity, world axes
[m/s, rad/s].

Rotations: R(t) = R_k exp(theta(t)) between two times, with a cubic polynomial theta; the rates at the times make the
angular acceleration continuous (scipy.spatial.transform.RotationSpline).
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.elements.signals import Signal
from contactvi.elements.user_functions import at, called
from contactvi.errors import InputError, UserFunctionError
from contactvi.inputs import pose, real_numbers, short

Array = NDArray[np.float64]

_STEP = 1e-4  # [s] distance of the points of differences, as of a Signal
_BESIDE = 3e-4  # [s] the same, of differences of velocities
_JUMP = 100.0  # ratio of one slope to the sum of the others from which a function jumps
_SLOW = 1e-3  # [m/s, rad/s] slope below which no function is said to jump
_HALF_TURN = 1e-6  # [rad] by which two rotations are less than half a turn apart, so that the shorter way is known


class FrameState(NamedTuple):
    """Position (3,), rotation (3, 3), velocity of the origin and angular velocity (3,) of a frame, world frame."""

    position: Array
    rotation: Array
    velocity: Array
    angular_velocity: Array


def _slope(around: Sequence[Array] | Array, step: float) -> Array:
    """Return a derivative to the fourth order, from values at -2, -1, 1 and 2 steps [s]."""
    return np.asarray((around[0] - 8.0 * around[1] + 8.0 * around[2] - around[3]) / (12.0 * step))


class PoseSignal:
    """A pose signal with a name, called as signal(t) -> FrameState; t [s].

    Attributes:
        name: for messages.
        times, poses: of a table, (n,) and (n, 7): xyz and quaternion xyzw; None otherwise.
        constant: its placement, (7,); None otherwise.
        function: as given by the user; None for placements and tables.

    Raises:
        InputError: The source is no pose signal. A call raises UserFunctionError with the name and the time.
    """

    def __init__(self, source: Any, name: str) -> None:
        self.name = name
        self.times: Array | None = None
        self.poses: Array | None = None
        self.constant: Array | None = None
        self.function: Any = None
        self._last: tuple[float, FrameState | None] = (np.nan, None)
        self._call: Callable[[float], FrameState]
        if isinstance(source, PoseSignal):
            source = source.source
        if isinstance(source, Mapping) and set(source) == {"times", "poses"}:
            source = (source["times"], source["poses"])
        if callable(source):
            self.function, self._call = source, self._asked
        elif _is_table(source):
            self.times, self.poses = _table(source, name)
            self._positions = [Signal((self.times, self.poses[:, k]), name) for k in range(3)]
            self._turns = _turns(self.times, [pose(name, numbers).rotation for numbers in self.poses], name)
            self._call = self._tabled
        else:
            self.constant = _numbers(name, source)
            place, still = pose(name, self.constant), np.zeros(3)
            state = FrameState(place.translation.copy(), place.rotation.copy(), still, still)
            self._call = lambda t: state

    @property
    def source(self) -> Any:
        """The placement, (times, poses) or function it was made of."""
        if self.function is not None:
            return self.function
        return self.constant if self.constant is not None else (self.times, self.poses)

    @property
    def storable(self) -> bool:
        """Whether a file can store it: it is data and no function."""
        return self.function is None

    def __call__(self, t: float) -> FrameState:
        """Return pose and velocity at t [s]."""
        known = self._last[1] if t == self._last[0] else None  # The engine asks several times for one instant.
        if known is None:
            known = self._call(t)
            self._last = t, known
        return known

    def acceleration(self, t: float) -> Array:
        """Return the linear and the angular acceleration at t [s], (6,), by differences of the velocity."""
        around = [np.concatenate(self._call(t + k * _BESIDE)[2:]) for k in (-2, -1, 1, 2)]
        return _slope(around, _BESIDE)

    def gives_velocity(self, t: float) -> bool:
        """Return whether a function of the user gives a velocity beside the pose at t [s]."""
        return self.function is not None and self._ask(t)[1] is not None

    def __deepcopy__(self, memo: Any) -> PoseSignal:
        return self  # A signal is constant, and functions of the user are not to be copied.

    def to_data(self) -> Any:
        """Return it as plain data: 7 numbers or {"times": [...], "poses": [...]}; None for a function."""
        if self.times is not None and self.poses is not None:
            return {"times": self.times.tolist(), "poses": self.poses.tolist()}
        return None if self.constant is None else self.constant.tolist()

    def _tabled(self, t: float) -> FrameState:
        x, v = np.array([axis(t)[:2] for axis in self._positions]).T
        assert self.times is not None
        k = min(max(bisect_right(self.times, t) - 1, 0), len(self._turns) - 1)
        start, coefficients = self._turns[k]
        s = t - self.times[k]
        theta = ((coefficients[0] * s + coefficients[1]) * s + coefficients[2]) * s
        rate = (3.0 * coefficients[0] * s + 2.0 * coefficients[1]) * s + coefficients[2]
        R = start @ pin.exp3(theta)
        return FrameState(x, R, v, R @ (pin.Jexp3(theta) @ rate))

    def _asked(self, t: float) -> FrameState:
        place, velocity = self._ask(t)
        if velocity is None:
            around = [self._ask(t + k * _STEP)[0] for k in (-2, -1, 1, 2)]
            moved = np.array([
                np.concatenate([near.translation - place.translation, pin.log3(near.rotation @ place.rotation.T)])
                for near in around
            ])  # fmt: skip
            self._refuse_jump(moved, t)
            velocity = _slope(moved, _STEP)
        return FrameState(place.translation.copy(), place.rotation.copy(), velocity[:3], velocity[3:])

    def _refuse_jump(self, moved: Array, t: float) -> None:
        """Raise UserFunctionError where one of the differences between four points, (4, 6), is far from the others."""
        steps = np.diff(moved, axis=0) / (np.array([1.0, 2.0, 1.0]) * _STEP)[:, None]
        slopes = np.linalg.norm(steps, axis=1)
        if slopes.max() <= _JUMP * (slopes.sum() - slopes.max()) + _SLOW:
            return
        raise UserFunctionError(
            f"{self.name} jumps{at(t)}", function=self.name, time=t, expected="a continuous motion",
            got=f"a change of {slopes.max() * _STEP:.6g} m, rad within {_STEP:g} s",
            remedy="Let it change within some time",
        )  # fmt: skip

    def _ask(self, t: float) -> tuple[pin.SE3, Array | None]:
        """Return what a function of the user gives: the pose, and the velocity (6,) if there is one."""
        result = called(self.function, self.name, t, t)
        given: Any = None
        if isinstance(result, (tuple, list)) and len(result) == 2 and _is_whole(result[0]):
            result, given = result
        wanted = "a pose: pin.SE3, (xyz, quaternion xyzw), 7 numbers"
        if result is None:
            raise self._wrong("pose", wanted, "None", t)
        try:
            place = pose(self.name, result)
        except InputError as error:
            raise self._wrong("pose", wanted, str(error.got), t) from None
        return place, None if given is None else self._velocity(given, t)

    def _velocity(self, given: Any, t: float) -> Array:
        if isinstance(given, pin.Motion):
            given = given.vector
        numbers = real_numbers(given)
        if numbers is None or numbers.shape not in ((6,), (2, 3)) or not np.isfinite(numbers).all():
            raise self._wrong("velocity", "(linear, angular): 6 finite numbers, or a pin.Motion", short(given), t)
        return numbers.reshape(6)

    def _wrong(self, part: str, expected: str, got: str, t: float) -> UserFunctionError:
        return UserFunctionError(
            f"{self.name} returned no {part}{at(t)}", function=self.name, time=t, entry=part, expected=expected,
            got=got, remedy=f"Correct what {self.name} returns as {part} at that time",
        )  # fmt: skip


def _is_whole(value: Any) -> bool:
    """Return whether the first of two things is a pose by itself, so that the second is its velocity."""
    if isinstance(value, pin.SE3):
        return True
    if isinstance(value, (tuple, list)) and len(value) == 2:
        return True
    numbers = real_numbers(value)
    return numbers is not None and numbers.shape in ((7,), (4, 4))


def _is_table(source: Any) -> bool:
    """Return whether a source is (times, poses) and not a placement (xyz, rpy) or (xyz, quaternion)."""
    if not isinstance(source, (tuple, list)) or len(source) != 2 or not isinstance(source[1], (Sequence, np.ndarray)):
        return False
    numbers = real_numbers(source[1])
    return numbers is None or numbers.ndim != 1


def _numbers(name: str, value: Any) -> Array:
    """Return a placement as xyz and quaternion xyzw, (7,): as given where it can be, so that data keep their bits."""
    place, given = pose(name, value), real_numbers(value)
    return given if given is not None and given.shape == (7,) else np.array(pin.SE3ToXYZQUAT(place))


def _table(source: Any, name: str) -> tuple[Array, Array]:
    times = real_numbers(source[0])
    if times is None or times.ndim != 1 or len(times) != len(source[1]) or len(times) < 2:
        raise InputError(
            f"Table of {name}", name=name, expected="(times, poses) of one length >= 2", got=short(source),
            remedy="Give one pose for each time, and at least two times; a constant is a plain placement",
        )  # fmt: skip
    return times, np.array([_numbers(f"{name}, pose {k}", value) for k, value in enumerate(source[1])])


def _turns(times: Array, rotations: Sequence[Array], name: str) -> list[tuple[Array, Array]]:
    """Return R_k and the coefficients (3, 3) of theta, highest power first, of each interval; times increase."""
    from scipy.spatial.transform import Rotation, RotationSpline

    steps = [pin.log3(a.T @ b) for a, b in zip(rotations[:-1], rotations[1:], strict=True)]
    far = next((k for k, step in enumerate(steps) if np.linalg.norm(step) > np.pi - _HALF_TURN), None)
    if far is not None:
        raise InputError(
            f"Table of {name}", name=name, expected="rotations less than half a turn apart",
            got=f"half a turn from {times[far]:.9g} to {times[far + 1]:.9g} s", remedy="Give poses in between",
        )  # fmt: skip
    rates = RotationSpline(times, Rotation.from_matrix(np.array(rotations)))(times, 1)  # in the axes of the frame
    found = []
    for k, step in enumerate(steps):
        h = float(times[k + 1] - times[k])
        first, last = rates[k], np.linalg.solve(pin.Jexp3(step), rates[k + 1])  # theta' at both ends
        cubic = (h * (first + last) - 2.0 * step) / h**3
        square = (3.0 * step - h * (2.0 * first + last)) / h**2
        found.append((np.array(rotations[k]), np.array([cubic, square, first])))
    return found
