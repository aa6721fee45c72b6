"""Closed linkages: time against error, contactvi with loops as constraints and SciPy's DOP853 in reduced coordinates.

    python benchmarks/linkages.py [--repeat 5] [--only biped] [--orders] [--costs]

The reduced coordinate of a linkage with one motion is the angle of its crank: the equation that a person derives by
hand, without any loop, in Python's floats. A biped with two closed legs (biped.py) has 8 or 14 coordinates; its
equations are Pinocchio's crba and rnea, projected, with the four-bars in closed form, as fast as Python gets without a
compiler. The same by Pinocchio's constraintDynamics in all joints stands beside it, and the faster one counts.

Each method is run with its own tolerance 1e-3, 1e-4, ... 1e-12, and the cheapest run counts whose error over all nodes
is below the one asked for: of the crank's angle, of the biped that of any joint, the trunk's place and its orientation.
The reference is DOP853 at 1e-13. Times are CPU times of the call alone, the least of some rounds through all methods.
Beside dt="auto" stands the best of some fixed settings in which no step was cut in two: what is lost by not knowing it.

--orders: the error at the end for steps of one length, and the observed order.
--costs: what a call, a step and a stage iteration of the biped cost, with its loops and without them; least squares
over steps of one length with several tolerances.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

import contactvi as cvi
from contactvi.verify import systems

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
import biped

from oracles import four_bar

ERRORS = (1e-4, 1e-6, 1e-8, 1e-10)
TOLERANCES = [float(tol) for tol in 10.0 ** -np.arange(3, 13)]
FIXED = {8: (6, 8, 12, 16, 24, 32, 48, 64, 96), 16: (4, 6, 8, 12, 16, 24, 32, 48, 64)}  # steps per second
STAGE_TOLS = (1e-6, 1e-8, 1e-10, 1e-12)
BAR, BARRED = 3.0, (1e-6, 1e-8)  # of DOP853's time over contactvi's, at these errors
SLIDER_CRANK = (0.1, 0.3)  # [m]
MASSES = (1.0, 2.0, 3.0)  # of crank, rod and slider [kg]
Array = np.ndarray
Accelerate = Callable[[float, float], float]  # of the crank [rad/s^2], by its angle and speed


class Reduced(NamedTuple):
    """Equations for DOP853: the derivative of the state, its start, and what of the states is compared."""

    rate: Callable[[float, Array], Array | list[float]]
    start: Array
    shown: Callable[[Array], Array]  # (n, nx) to (n, m)

    def run(self, duration: float, tol: float, dense: bool = False) -> tuple:
        """Return t, what is compared (lazily, as it is not to be timed), and the dense output if asked for."""
        found = solve_ivp(
            self.rate, (0.0, duration), self.start, method="DOP853", rtol=tol, atol=tol if tol > 1e-13 else 1e-14,
            dense_output=dense,
        )  # fmt: skip
        return found.t, partial(self.shown, found.y.T), found.sol


@dataclass(frozen=True)
class Linkage:
    """A linkage as contactvi has it, and its rivals and reference in reduced coordinates."""

    name: str
    scene: cvi.Scene
    q: Array
    v: Array
    duration: float
    rivals: dict[str, Reduced]
    reference: Reduced
    shown: Callable[[Array], Array]  # of contactvi's q
    distance: Callable[[Array, Array], float]


def four_bar_in_floats(phi: float, rate: float) -> float:
    """Return phi'' [rad/s^2] of bars of 1 kg/m: oracles/four_bar.py for one number, without numpy."""
    a, b, c, ground = systems.FOUR_BAR
    x, z = ground - a * math.cos(phi), -a * math.sin(phi)
    s, across = math.hypot(x, z), math.atan2(z, x)
    psi = across + math.acos((b * b + s * s - c * c) / (2.0 * b * s))
    chi = across - math.acos((c * c + s * s - b * b) / (2.0 * c * s))
    between = math.sin(chi - psi)
    r = a * math.sin(phi - chi) / (b * between), a * math.sin(psi - phi) / (c * between)  # rates of psi and chi
    bent = a * math.cos(phi - chi) + b * math.cos(psi - chi) * r[0] ** 2 + c * r[1] ** 2
    back = a * math.cos(phi - psi) + b * r[0] ** 2 + c * math.cos(chi - psi) * r[1] ** 2
    q = bent / (b * between), -back / (c * between)  # and how they grow by phi
    x1 = z1 = x2 = z2 = inertia = force = weight = 0.0
    for length, angle, first, second in ((a, phi, 1.0, 0.0), (b, psi, r[0], q[0]), (c, chi, r[1], q[1])):
        cosine, sine = math.cos(angle), math.sin(angle)
        step_x, step_z = -length * sine * first, length * cosine * first
        more_x = -length * (sine * second + cosine * first * first)
        more_z = length * (cosine * second - sine * first * first)
        mid_x, mid_z, far_x, far_z = x1 + 0.5 * step_x, z1 + 0.5 * step_z, x2 + 0.5 * more_x, z2 + 0.5 * more_z
        inertia += length * (mid_x * mid_x + mid_z * mid_z) + length**3 / 12.0 * first * first
        force += length * (mid_x * far_x + mid_z * far_z) + length**3 / 12.0 * first * second
        weight += length * systems.GRAVITY * mid_z
        x1, z1, x2, z2 = x1 + step_x, z1 + step_z, x2 + more_x, z2 + more_z
    return -(force * rate * rate + weight) / inertia


def slider_crank_acceleration(phi: float, rate: float) -> float:
    """Return phi'' [rad/s^2] of a crank, its rod and a slider on the x axis."""
    (r, s), (m1, m2, m3) = SLIDER_CRANK, MASSES
    sine, cosine = math.sin(phi), math.cos(phi)
    below = -r / s * sine  # sine of the rod's angle
    beside = math.sqrt(1.0 - below**2)
    turn = -r / s * cosine / beside  # of the rod's angle by phi, and its derivative
    turn2 = (r / s * sine + turn**2 * below) / beside
    along = -r * sine - s * below * turn
    along2 = -r * cosine - s * (beside * turn**2 + below * turn2)
    x1, x2 = -r * sine - 0.5 * s * below * turn, -r * cosine - 0.5 * s * (beside * turn**2 + below * turn2)
    z1, z2 = r * cosine + 0.5 * s * beside * turn, -r * sine + 0.5 * s * (beside * turn2 - below * turn**2)
    inertia = m1 * r * r / 3.0 + m2 * (x1**2 + z1**2 + s * s / 12.0 * turn**2) + m3 * along**2
    bent = m2 * (x1 * x2 + z1 * z2 + s * s / 12.0 * turn * turn2) + m3 * along * along2
    weight = systems.GRAVITY * (m1 * 0.5 * r * cosine + m2 * z1)
    return -(bent * rate**2 + weight) / inertia


def cranked(
    name: str, scene: cvi.Scene, q: Array, rate: float, accelerate: Accelerate, exact: Accelerate | None = None
) -> Linkage:
    """A linkage with one motion, of 2 s, whose crank has this speed [rad/s] in the beginning."""
    v = scene.consistent_velocity(q, np.eye(scene.nv)[0])
    v *= rate / v[0]

    def first(rows: Array) -> Array:
        return rows[:, :1]

    def reduced(function: Accelerate) -> Reduced:
        return Reduced(lambda _t, y: [y[1], function(*y.tolist())], np.array([q[0], rate]), first)

    def distance(a: Array, b: Array) -> float:
        return float(np.abs(a - b).max())

    return Linkage(
        name, scene, q, v, 2.0, {"DOP853": reduced(accelerate)}, reduced(exact or accelerate), first, distance
    )


def walker(flies: bool) -> Linkage:
    """The biped of biped.py; each method has its own workspace."""
    own = biped.Biped(flies)
    y, u = own.start()
    q, v = own.all_joints(y, u)
    n = own.model.nq

    def places(rows: Array) -> Array:
        return np.array([own.place(row[: own.nq]).copy() for row in rows])

    def configurations(rows: Array) -> Array:
        return rows[:, :n]

    reduced = Reduced(own.rate, np.append(y, u), places)
    name = "biped, in flight" if flies else "biped, trunk fixed"
    rivals = {"DOP853": reduced, "constraintDynamics": Reduced(own.by_constraints(), np.append(q, v), configurations)}
    return Linkage(
        name, own.scene(), q, v, biped.DURATION, rivals, reduced, configurations, partial(biped.distance, own.model)
    )


def all_linkages() -> list[Linkage]:
    def of_four_bar(phi: float, rate: float) -> float:
        return four_bar.acceleration(systems.FOUR_BAR, phi, rate)

    slider, stretched = systems.free_slider_crank(SLIDER_CRANK, MASSES), np.array([0.0, 0.0, sum(SLIDER_CRANK)])
    return [
        cranked("four-bar", systems.four_bar(), systems.four_bar_angles(0.3), 2.0, four_bar_in_floats, of_four_bar),
        cranked("slider-crank", slider, stretched, 20.0, slider_crank_acceleration),
        walker(flies=False),
        walker(flies=True),
    ]


def least(calls: dict[str, Callable[[], object]], repeat: int) -> dict[str, float]:
    """Return the least CPU time of each call [ms], in rounds through all of them."""
    best = dict.fromkeys(calls, np.inf)
    for _ in range(repeat):
        for name, call in calls.items():
            begin = time.process_time()
            call()
            best[name] = min(best[name], 1e3 * (time.process_time() - begin))
    return best


def simulation(linkage: Linkage, setting: dict[str, Any]) -> Callable[[], cvi.Trajectory]:
    """Return a call of simulate, without its warnings."""

    def call() -> cvi.Trajectory:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return cvi.simulate(linkage.scene, linkage.q, linkage.v, linkage.duration, **setting)

    return call


def best_fixed(linkage: Linkage, error: Callable[[Array, Array], float], repeat: int) -> dict[float, float]:
    """Return for each error asked for the time of the best fixed setting [ms]; infinite where none meets it."""
    found = []
    for order, counts in FIXED.items():
        for count in counts:
            for tol in STAGE_TOLS:
                call = simulation(linkage, {"order": order, "dt": 1.0 / count, "solver_tol": tol})
                try:
                    traj = call()
                except cvi.ContactviError:
                    continue
                if traj.status.ok and not traj.stats.halved:
                    found.append((least({"": call}, 1)[""], error(traj.t, linkage.shown(traj.q)), call))
    times = {}
    for asked in ERRORS:
        good = sorted((row for row in found if row[1] <= asked), key=lambda row: row[0])[:4]
        times[asked] = min(least({str(k): row[2] for k, row in enumerate(good)}, repeat).values(), default=np.inf)
    return {asked: min(time for error, time in times.items() if error <= asked) for asked in ERRORS}


def compare(linkage: Linkage, repeat: int) -> None:
    exact = linkage.reference.run(linkage.duration, 1e-13, dense=True)[2]

    def error(t: Array, shown: Array) -> float:
        return linkage.distance(shown, linkage.reference.shown(exact(t).T))

    rows: list[tuple[str, float, float]] = []
    for tol in TOLERANCES:
        calls: dict[str, Callable[[], object]] = {
            who: partial(rival.run, linkage.duration, tol) for who, rival in linkage.rivals.items()
        }
        automatic = simulation(linkage, {"tol": tol})
        calls["contactvi"] = automatic
        spent, traj = least(calls, repeat), automatic()
        errors = {"contactvi": error(traj.t, linkage.shown(traj.q))}
        for who, rival in linkage.rivals.items():
            t, shown, _ = rival.run(linkage.duration, tol)
            errors[who] = error(t, shown())
        rows += [(who, errors[who], spent[who]) for who in calls]
        last = f"{traj.stats.steps} steps and {traj.stats.sweeps} stage iterations in the last run"
        told = f"error {errors['contactvi']:.1e}, estimate {traj.error_estimate:.1e}"
        print(f"  {linkage.name}: tol {tol:.0e}: {last}, {told}", file=sys.stderr)
    fixed = best_fixed(linkage, error, repeat)
    for asked in ERRORS:
        best = {who: min((t for w, e, t in rows if w == who and e <= asked), default=np.nan) for who, *_ in rows}
        who = min(linkage.rivals, key=lambda name: best[name] if np.isfinite(best[name]) else np.inf)
        ratio = best[who] / best["contactvi"]
        verdict = ("met" if ratio >= BAR else "MISSED") if asked in BARRED else "-"
        others = ", ".join(f"{best[name]:.2f}" if np.isfinite(best[name]) else "never" for name in linkage.rivals)
        known = f"{fixed[asked]:.2f} | {best[who] / fixed[asked]:.2g}" if np.isfinite(fixed[asked]) else "never | -"
        own = f"{best['contactvi']:.2f}"
        print(f"| {linkage.name} | {asked:.0e} | {own} | {others} | {ratio:.2g} | {verdict} | {known} |")


def orders(linkage: Linkage) -> None:
    end = np.array([linkage.duration])
    exact = linkage.reference.run(linkage.duration, 1e-13, dense=True)[2]
    shown = linkage.reference.shown(exact(end).T)
    for order, counts in ((2, (800, 1600, 3200)), (4, (400, 800, 1600)), (8, (100, 200, 400)), (16, (40, 60, 80))):
        errors = []
        for n in counts:
            options: dict[str, Any] = {"dt": linkage.duration / n, "order": order, "solver_tol": 1e-14}
            traj = cvi.simulate(linkage.scene, linkage.q, linkage.v, linkage.duration, **options)
            errors.append(linkage.distance(linkage.shown(traj.q[-1:]), shown))
        seen = np.log(np.divide(errors[:-1], errors[1:])) / np.log(np.divide(counts[1:], counts[:-1]))
        print(f"| {order} | {', '.join(f'{e:.1e}' for e in errors)} | {', '.join(f'{o:.2f}' for o in seen)} |")


def costs(repeat: int) -> None:
    """Print what a call, a step and a stage iteration of the biped cost, with loops and without."""
    print("| biped | order | loops | call [us] | step [us] | stage iteration [us] |\n|---|---|---|---|---|---|")
    for flies in (False, True):
        linkage = walker(flies)
        for order in (8, 16):
            for loops, scene in (("yes", linkage.scene), ("no", cvi.Scene.from_pinocchio(biped.model(flies)))):
                rows, times = [], []
                for count, tol in ((n, tol) for n in (24, 32, 48, 64) for tol in (1e-7, 1e-9, 1e-11, 1e-13)):
                    setting = {"order": order, "dt": linkage.duration / count, "solver_tol": tol, "dense": False}
                    call = simulation(replace(linkage, scene=scene), setting)
                    stats = call().stats
                    if stats.steps == count and not stats.halved:
                        rows.append((1.0, count, stats.sweeps))
                        times.append(1e3 * least({"": call}, repeat)[""])
                each = np.linalg.lstsq(np.array(rows), np.array(times), rcond=None)[0]
                name = linkage.name.removeprefix("biped, ")
                print(f"| {name} | {order} | {loops} | " + " | ".join(f"{value:.3g}" for value in each) + " |")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--only", default="", help="linkages whose names begin with this")
    parser.add_argument("--orders", action="store_true")
    parser.add_argument("--costs", action="store_true")
    chosen = parser.parse_args(arguments)
    if chosen.costs:
        costs(chosen.repeat)
        return
    linkages = [linkage for linkage in all_linkages() if linkage.name.startswith(chosen.only)]
    if chosen.orders:
        for linkage in linkages:
            print(f"{linkage.name}\n\n| order | errors [rad, m] | observed order |\n|---|---|---|")
            orders(linkage)
        return
    print("| linkage | error [rad, m] | contactvi [ms] | DOP853: reduced, constraintDynamics [ms] | ratio | bar of 3"
          " | fixed [ms] | its ratio |\n|---|---|---|---|---|---|---|---|")  # fmt: skip
    for linkage in linkages:
        compare(linkage, chosen.repeat)


if __name__ == "__main__":
    main()
