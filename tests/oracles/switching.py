"""Motions with piecewise force laws, integrated from one change of a law to the next by SciPy's DOP853.

Nothing of the engine is used: the laws are written out again, and where one changes is found by SciPy's events, on
pieces of the time that are short beside the motion. What is slow is obvious.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]

TOLERANCE = 1e-13  # relative and absolute, of each step
SAME = 1e-12  # [m] of a rope's excess: ropes that are nearer to where they change do so together


@dataclass
class Rope:
    """Spring and damper from a fixed point to a ball: it does not push."""

    anchor: Array
    stiffness: float
    rest: float
    damping: float = 0.0

    def measure(self, x: Array, v: Array) -> tuple[float, float, Array]:
        """Return the length over that at rest, what spring and damper pull with, and the direction to the ball."""
        away = x - self.anchor
        length = float(np.linalg.norm(away))
        over = length - self.rest
        return over, self.stiffness * over + self.damping * float(away @ v) / length, away / length

    def pulls(self, x: Array, v: Array) -> bool:
        over, pull, _ = self.measure(x, v)
        return over > 0.0 and pull > 0.0


@dataclass
class BallOnRopes:
    """A point mass on ropes, and above a plane z = 0 if it has a restitution there."""

    mass: float
    ropes: list[Rope]
    gravity: float = 9.81
    radius: float = 0.0
    restitution: float | None = None
    switches: list[float] = field(default_factory=list)

    def motion(self, x: Array, v: Array, times: Array, piece: float = 2e-3) -> Array:
        """Return positions and velocities at times, shape (N, 6)."""
        state, t = np.concatenate([x, v]), 0.0
        taut = [rope.pulls(x, v) for rope in self.ropes]
        rows = []
        for end in times:
            while t < end:
                state, t, taut = self._piece(state, t, min(end, t + piece), taut)
            rows.append(state.copy())
        return np.array(rows)

    def _piece(self, state: Array, t: float, end: float, taut: list[bool]) -> tuple[Array, float, list[bool]]:
        def rate(_t: float, y: Array) -> Array:
            force = np.array([0.0, 0.0, -self.mass * self.gravity])
            for rope, pulls in zip(self.ropes, taut, strict=True):
                if pulls:
                    _, pull, along = rope.measure(y[:3], y[3:])
                    force -= pull * along
            return np.concatenate([y[3:], force / self.mass])

        events: list[Callable[[float, Array], float]] = []
        for rope, pulls in zip(self.ropes, taut, strict=True):
            events.append(_rope_event(rope, pulls))
        if self.restitution is not None:
            events.append(lambda _t, y: float(y[2] - self.radius))
        for event in events:
            event.terminal, event.direction = True, -1.0  # type: ignore[attr-defined]
        run = solve_ivp(rate, (t, end), state, "DOP853", rtol=TOLERANCE, atol=TOLERANCE, events=events)
        assert run.success
        state, now = run.y[:, -1], float(run.t[-1])
        taut = list(taut)
        for k, found in enumerate(run.t_events):
            if not len(found):
                continue
            if k == len(self.ropes):
                state = state.copy()
                state[5] = -self.restitution * state[5]
                # A damper's pull jumps with the velocity.
                taut = [rope.pulls(state[:3], state[3:]) for rope in self.ropes]
                continue
            taut[k] = not taut[k]
            self.switches.append(now)
            for other, event in enumerate(events[: len(self.ropes)]):  # those at the same instant
                if other != k and abs(event(now, state)) <= SAME:
                    taut[other] = not taut[other]
                    self.switches.append(now)
            break
        return state, now, taut


def _rope_event(rope: Rope, pulls: bool) -> Callable[[float, Array], float]:
    sign = 1.0 if pulls else -1.0

    def event(_t: float, y: Array) -> float:
        over, pull, _ = rope.measure(y[:3], y[3:])
        scaled = pull / rope.stiffness if rope.damping else over
        return sign * min(over, scaled)

    return event


@dataclass
class Servo:
    """Torque of a servo on a pendulum with one joint: clamped."""

    kp: float
    kd: float
    target: float
    most: float

    def asked(self, q: float, v: float) -> float:
        return self.kp * (self.target - q) - self.kd * v


def servo_pendulum(
    inertia: float, weight: float, servo: Servo, q: float, v: float, times: Array, piece: float = 2e-3
) -> tuple[Array, int]:
    """Return angle and speed at times, shape (N, 2), and how often the torque came to its limit or left it.

    inertia about the joint [kg m^2], weight: mass times gravity times the distance of the centre [N m]; q = 0 hangs.
    """
    state, t, rows, switches = np.array([q, v]), 0.0, [], 0
    branch = int(np.sign(servo.asked(q, v))) if abs(servo.asked(q, v)) > servo.most else 0
    for end in times:
        while t < end:
            now = branch

            def rate(_t: float, y: Array, now: int = now) -> list[float]:
                torque = now * servo.most if now else servo.asked(y[0], y[1])
                return [y[1], (torque - weight * np.sin(y[0])) / inertia]

            def low(_t: float, y: Array) -> float:
                return servo.asked(y[0], y[1]) + servo.most

            def high(_t: float, y: Array) -> float:
                return servo.asked(y[0], y[1]) - servo.most

            events = [low, high]
            low.direction = -1.0 if now == 0 else 1.0 if now == -1 else 0.0  # type: ignore[attr-defined]
            high.direction = 1.0 if now == 0 else -1.0 if now == 1 else 0.0  # type: ignore[attr-defined]
            low.terminal = now != 1  # type: ignore[attr-defined]
            high.terminal = now != -1  # type: ignore[attr-defined]
            run = solve_ivp(
                rate, (t, min(end, t + piece)), state, "DOP853", rtol=TOLERANCE, atol=TOLERANCE, events=events
            )
            state, t = run.y[:, -1], float(run.t[-1])
            if run.status == 1:
                hit = 1 if len(run.t_events[1]) and now != -1 else -1
                branch = 0 if now else hit
                switches += 1
        rows.append(state.copy())
    return np.array(rows), switches
