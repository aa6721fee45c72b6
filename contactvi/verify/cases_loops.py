"""Cases of closed loops: slider-cranks without and with clearance, a four-bar driven and at an elastic stop."""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import solve_ivp

from contactvi.reproduce.check import Check, at_least, at_most, near
from contactvi.verify import systems
from contactvi.verify.case import Case, Runs
from contactvi.verify.cases_forced import residual
from contactvi.verify.systems import GRAVITY as _G

_PHI = "phi of constraints"
_SPEEDS = (150.0, -75.0, 0.0)  # of crank, rod and slider of the slider-crank with clearance at its start [rad/s]


def driven_slider_crank(runs: Runs) -> list[Check]:
    """Closed form at constant speed w: torque w^2 J'(phi) / 2 + V'(phi), J(phi) w^2 / 2 the kinetic energy.

    The rod's angle b: sin b = -(r/s) sin phi, r and s the lengths of crank and rod. J and V are differentiated by a
    complex step, exact to rounding.
    """
    lengths, masses, w = (0.1, 0.3), (1.0, 2.0, 3.0), 10.0
    scene = systems.slider_crank(lengths, masses, w)
    crank, rod = lengths
    checks, errors = [], []
    for h in (0.004, 0.002, 0.001):
        q = np.array([0.0, 0.0, crank + rod])
        traj = runs.simulate(scene, q, scene.consistent_velocity(q), 0.8, h)
        phi, of = w * traj.t, f", h = {h:g}"
        torque = crank_torque(0.5 * (phi[1:] + phi[:-1]), w, lengths, masses)
        errors.append(float(np.abs(traj.reactions("motion")[1:, 0] - torque).max()))
        place = crank * np.cos(phi) + np.sqrt(rod**2 - (crank * np.sin(phi)) ** 2)
        off = float(np.abs(traj.q[:, 2] - place).max())
        checks += [
            at_most(f"place of the slider, largest error [m]{of}", 1e-10, off, _PHI),
            at_most(f"torque, largest error [N m]{of}", (w * h) ** 2 * float(np.abs(torque).max()), errors[-1],
                    "second order: (w h)^2 of the largest torque"),
        ]  # fmt: skip
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    return [*checks, near("order of the torque", [2.0, 2.0], orders, 0.05, "second order; terms of higher order")]


def crank_torque(phi: np.ndarray, w: float, lengths: tuple[float, ...], masses: tuple[float, ...]) -> np.ndarray:
    """Return the torque that turns the crank at w [rad/s], (n,) [N m]."""
    (r, s), (m1, m2, m3) = lengths, masses
    step = 1e-30
    x = phi + 1j * step
    sine, cosine = -(r / s) * np.sin(x), np.sqrt(1.0 - (r / s * np.sin(x)) ** 2)  # of the rod's angle
    turn = -(r * np.cos(x)) / (s * cosine)  # db/dphi
    along = -r * np.sin(x) - s * sine * turn  # dx/dphi of the slider
    rod = (-r * np.sin(x) - 0.5 * s * sine * turn) ** 2 + (r * np.cos(x) + 0.5 * s * cosine * turn) ** 2
    J = m1 * r * r / 3.0 + m2 * (rod + s * s * turn**2 / 12.0) + m3 * along**2
    V = _G * (m1 * 0.5 * r * np.sin(x) + m2 * (r * np.sin(x) + 0.5 * s * sine))
    return np.asarray((0.5 * w * w * J + V).imag / step)


def driven_four_bar(runs: Runs) -> list[Check]:
    """Closed form: the angles of a crank-rocker follow from its crank's by two triangles; 20 turns of the crank."""
    w, h = 2.0 * math.pi, 0.01
    scene = systems.four_bar(speed=w)
    q = systems.four_bar_angles(0.0)
    traj = runs.simulate(scene, q, scene.consistent_velocity(q), 20.0, h)
    exact = systems.four_bar_angles(w * traj.t)
    exact[:, 1:] = np.unwrap(exact[:, 1:], axis=0)
    off = np.abs(traj.q - exact).max(axis=0)
    rate = (systems.four_bar_angles(1e-4) - systems.four_bar_angles(-1e-4)) / 2e-4 * w
    return [
        at_most("crank, largest error [rad]", 1e-10, float(off[0]), _PHI),
        at_most("coupler, largest error [rad]", 1e-9, float(off[1]), _PHI + ", over the sine of the angle at its pin"),
        at_most("rocker, largest error [rad]", 1e-9, float(off[2]), _PHI + ", over the sine of the angle at its pin"),
        near(
            "velocities after whole turns [rad/s]", rate, traj.v[-1], 1e-5, "differences of the closed form, 1e-8 w^3"
        ),
        at_most("loop open by [m, rad]", 1e-10, residual(traj), _PHI),
    ]


def four_bar_stop(runs: Runs) -> list[Check]:
    """Laws of an elastic impact on a loop: the energy and the loop stay, gamma+ = -gamma-, 10 s of them."""
    scene = systems.four_bar(stop=0.55)
    q = systems.four_bar_angles(0.4)
    v = scene.consistent_velocity(q, [5.0, -5.0, 0.0])
    core, checks, spread = scene.core(), [], []
    for h in (2e-3, 1e-3):
        traj, of = runs.simulate(scene, q, v, 10.0, h), f", h = {h:g}"
        largest = float(traj.kinetic_energy.max())
        jumps = [abs(event.energy_change) / largest for event in traj.events]
        speeds = [abs(event.gamma_plus + event.gamma_minus) for event in traj.events]
        after = [
            float(np.abs(core.constraint_jacobian(e.q, e.time) @ core.velocity(e.q[None], e.p_plus[None])[0]).max())
            for e in traj.events
        ]
        spread.append(float(np.ptp(traj.energy)))
        exact = systems.four_bar_angles(traj.q[:, 0])
        closed = np.abs(np.angle(np.exp(1j * (traj.q - exact)))).max()
        checks += [
            at_least(f"impacts{of}", 10.0, float(len(traj.events)), "enough impacts to judge by"),
            at_most(f"change of the energy at an impact, over T{of}", 1e-12, max(jumps, default=math.inf), "rounding"),
            at_most(f"gamma+ + gamma- [m/s]{of}", 1e-11, max(speeds, default=math.inf), "rounding over the inertia"),
            at_most(f"speed at the loop after it [m/s]{of}", 1e-10, max(after, default=math.inf), "projected"),
            at_most(f"loop open by [m]{of}", 1e-10, residual(traj), _PHI),
            at_most(
                f"angles against two triangles [rad]{of}", 1e-9, float(closed), _PHI + ", over the sine at its pin"
            ),
        ]
    order = math.log2(spread[0] / spread[1])
    return [*checks, near("order of the energy's variation in between", 2.0, order, 0.1, "second order, no drift")]


def slider_with_clearance(runs: Runs) -> list[Check]:
    """Laws of the slider-crank of Flores, Leine, Glocker 2010: h against h/4, no impact gains energy.

    The first impact is that of a DOP853 run without the clearance's walls.
    """
    scene, T = systems.slider_with_clearance(), 0.2
    v = [_SPEEDS[0], _SPEEDS[1] - _SPEEDS[0], _SPEEDS[2] - _SPEEDS[1]]  # joints' angles are differences
    found, checks = [], []
    first, speed = first_touch()
    way = systems.LENGTHS[0] * _SPEEDS[0] * first  # of the crank's end, which the rod all but makes up for
    for h in (1e-5, 2.5e-6):
        traj, of = runs.simulate(scene, np.zeros(3), v, T, h), f", h = {h:g}"
        found.append(traj)
        gain = max((event.energy_change for event in traj.events), default=math.inf)
        taken = traj.energy[0] - traj.energy[-1] - traj.impact_loss[-1] - traj.friction_loss[-1]
        checks += [
            near(f"first impact [s]{of}", first, traj.events[0].time, way / speed * (225.0 * h) ** 2,
                 "second order: (w h)^2 of the crank's way over the closing speed, w = 225 rad/s at the rod's hinge"),
            at_least(f"impacts{of}", 10.0, float(len(traj.events)), "enough impacts to judge by"),
            at_most(f"largest change of the energy at an impact [J]{of}", 0.0, gain, "e = .4: no impact gains energy"),
            near(f"energy lost less losses at impacts and by sliding [J]{of}", 0.0, taken, 7.5 * (225.0 * h) ** 2,
                 "second order: (w h)^2 of the energy of 7.5 J"),
        ]  # fmt: skip
    coarse, fine = found
    turned = 0.2 * _SPEEDS[0]
    return [
        *checks,
        at_most("h against h/4: crank's and rod's angles [rad]", turned * (225.0 * 1e-5) ** 2,
                float(np.abs(coarse.q[:, :2] - fine.q[::4, :2]).max()), "second order: (w h)^2 of the angle turned"),
        at_most("h against h/4: speed of the crank, of 150 rad/s", 150.0 * turned * (225.0 * 1e-5) ** 2,
                float(abs(coarse.v[-1, 0] - fine.v[-1, 0])), "second order: (w h)^2 of angle times speed"),
    ]  # fmt: skip


def first_touch() -> tuple[float, float]:
    """Return the time [s] at which the slider first uses up its clearance, turning not before, and its speed."""
    (r, s), (m1, m2, m3), (J1, J2, _) = systems.LENGTHS, systems.MASSES, systems.INERTIAS

    def rate(_t: float, y: np.ndarray) -> list[float]:
        """d(a, b, a', b')/dt of crank and rod with the slider's mass at the rod's end, absolute angles."""
        a, b, u, w = y
        couple = (0.5 * m2 + m3) * r * s
        M = np.array([[J1 + m1 * r * r / 4.0 + (m2 + m3) * r * r, couple * math.cos(a - b)],
                      [couple * math.cos(a - b), J2 + m2 * s * s / 4.0 + m3 * s * s]])  # fmt: skip
        force = [
            -couple * math.sin(a - b) * w * w - _G * (0.5 * m1 + m2 + m3) * r * math.cos(a),
            couple * math.sin(a - b) * u * u - _G * (0.5 * m2 + m3) * s * math.cos(b),
        ]
        return [u, w, *np.linalg.solve(M, force)]

    def gap(_t: float, y: np.ndarray) -> float:
        return systems.CLEARANCE - abs(r * math.sin(y[0]) + s * math.sin(y[1]))

    gap.terminal = True  # type: ignore[attr-defined]
    run = solve_ivp(rate, (0.0, 0.05), [0.0, 0.0, *_SPEEDS[:2]], method="DOP853", events=gap, rtol=1e-12, atol=1e-13)
    a, b, u, w = run.y_events[0][0]
    return float(run.t_events[0][0]), abs(r * math.cos(a) * u + s * math.cos(b) * w)


CASES = (
    Case("slider-crank", "a slider-crank at constant speed: its torque", driven_slider_crank),
    Case("four-bar", "a driven four-bar: its angles", driven_four_bar),
    Case("four-bar-stop", "a four-bar hits an elastic stop", four_bar_stop),
    Case("slider-crank-clearance", "a slider-crank with clearance", slider_with_clearance, former="N22"),
)
