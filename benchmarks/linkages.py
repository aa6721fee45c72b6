"""Closed linkages: time against error, contactvi with loops as constraints and SciPy's DOP853 in reduced coordinates.

    python benchmarks/linkages.py [--repeat 5] [--orders]

The reduced coordinate of a linkage with one motion is the angle of its crank (tests/oracles/four_bar.py): the equation
that a person derives by hand, without any loop. Each method is run with its own tolerance 1e-3, 1e-4, ... 1e-12, and
the cheapest run counts whose error of the crank's angle over all nodes is below the one asked for. The reference is
DOP853 at 1e-13. Times are the least of some repetitions, of the call alone.

--orders: the error at the end for steps of one length, and the observed order.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

import contactvi as cvi
from contactvi.verify import systems

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from oracles import four_bar

DURATION = 2.0
ERRORS = (1e-4, 1e-6, 1e-8, 1e-10)
TOLERANCES = 10.0 ** -np.arange(3, 13)
SLIDER_CRANK = (0.1, 0.3)  # [m]
MASSES = (1.0, 2.0, 3.0)  # of crank, rod and slider [kg]
Accelerate = Callable[[float, float], float]
Start = tuple[float, float]  # angle and speed of the crank [rad, rad/s]


def slider_crank_acceleration(phi: float, rate: float) -> float:
    """Return phi'' [rad/s^2] of a crank, its rod and a slider on the x axis."""
    (r, s), (m1, m2, m3) = SLIDER_CRANK, MASSES
    sine, cosine = np.sin(phi), np.cos(phi)
    below = -r / s * sine  # sine of the rod's angle
    beside = np.sqrt(1.0 - below**2)
    turn = -r / s * cosine / beside  # of the rod's angle by phi, and its derivative
    turn2 = (r / s * sine + turn**2 * below) / beside
    along = -r * sine - s * below * turn
    along2 = -r * cosine - s * (beside * turn**2 + below * turn2)
    x1, x2 = -r * sine - 0.5 * s * below * turn, -r * cosine - 0.5 * s * (beside * turn**2 + below * turn2)
    z1, z2 = r * cosine + 0.5 * s * beside * turn, -r * sine + 0.5 * s * (beside * turn2 - below * turn**2)
    inertia = m1 * r * r / 3.0 + m2 * (x1**2 + z1**2 + s * s / 12.0 * turn**2) + m3 * along**2
    bent = m2 * (x1 * x2 + z1 * z2 + s * s / 12.0 * turn * turn2) + m3 * along * along2
    weight = systems.GRAVITY * (m1 * 0.5 * r * cosine + m2 * z1)
    return float(-(bent * rate**2 + weight) / inertia)


def reduced(accelerate: Accelerate, start: Start, tol: float, times: np.ndarray | None = None) -> np.ndarray:
    """Return t and the crank's angle of DOP853, (2, n)."""
    found = solve_ivp(
        lambda _t, y: [y[1], accelerate(y[0], y[1])],
        (0.0, DURATION), start, method="DOP853", rtol=tol, atol=tol, t_eval=times, dense_output=False,
    )  # fmt: skip
    return np.stack([found.t, found.y[0]])


def least(call: Callable[[], object], repeat: int) -> float:
    """Return the least time of some calls [ms]."""
    best = np.inf
    for _ in range(repeat):
        begin = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - begin)
    return 1e3 * best


def compare(name: str, scene: cvi.Scene, q: np.ndarray, accelerate: Accelerate, rate: float, repeat: int) -> None:
    v = scene.consistent_velocity(q, np.eye(scene.nv)[0])
    v *= rate / v[0]
    start = (float(q[0]), rate)
    exact = solve_ivp(
        lambda _t, y: [y[1], accelerate(y[0], y[1])], (0.0, DURATION), start, method="DOP853", rtol=1e-13, atol=1e-14,
        dense_output=True,
    ).sol  # fmt: skip
    rows = []
    for tol in TOLERANCES:
        found = reduced(accelerate, start, float(tol))
        error = np.abs(found[1] - exact(found[0])[0]).max()
        rows.append(("DOP853", error, least(lambda tol=tol: reduced(accelerate, start, float(tol)), repeat)))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            traj = cvi.simulate(scene, q, v, duration=DURATION, tol=float(tol))
            error = np.abs(traj.q[:, 0] - exact(traj.t)[0]).max()
            spent = least(lambda tol=tol: cvi.simulate(scene, q, v, duration=DURATION, tol=float(tol)), repeat)
        rows.append(("contactvi", error, spent))
        print(f"  {name}: tol {tol:.0e}: error {error:.1e}, estimate {traj.error_estimate:.1e}", file=sys.stderr)
    for asked in ERRORS:
        best = {who: min((t for w, e, t in rows if w == who and e <= asked), default=np.nan) for who, *_ in rows}
        ratio = best["DOP853"] / best["contactvi"]
        print(f"| {name} | {asked:.0e} | {best['contactvi']:.2f} | {best['DOP853']:.2f} | {ratio:.1f} |")


def orders(scene: cvi.Scene, q: np.ndarray, accelerate: Accelerate, rate: float) -> None:
    v = scene.consistent_velocity(q, np.eye(scene.nv)[0])
    v *= rate / v[0]
    exact = reduced(accelerate, (float(q[0]), rate), 1e-13, np.array([0.0, DURATION]))[1, -1]
    for order, counts in ((2, (800, 1600, 3200)), (4, (400, 800, 1600)), (8, (100, 200, 400)), (16, (40, 60, 80))):
        errors = [
            abs(cvi.simulate(scene, q, v, duration=DURATION, dt=DURATION / n, order=order, tol=1e-14).q[-1, 0] - exact)
            for n in counts
        ]
        seen = np.log(np.divide(errors[:-1], errors[1:])) / np.log(np.divide(counts[1:], counts[:-1]))
        print(f"| {order} | {', '.join(f'{e:.1e}' for e in errors)} | {', '.join(f'{o:.2f}' for o in seen)} |")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--orders", action="store_true")
    chosen = parser.parse_args(arguments)
    bars = systems.FOUR_BAR

    def of_four_bar(phi: float, rate: float) -> float:
        return four_bar.acceleration(bars, phi, rate)

    slider, stretched = systems.free_slider_crank(SLIDER_CRANK, MASSES), np.array([0.0, 0.0, sum(SLIDER_CRANK)])
    linkages = (
        ("four-bar", systems.four_bar(), systems.four_bar_angles(0.3), of_four_bar, 2.0),
        ("slider-crank", slider, stretched, slider_crank_acceleration, 20.0),
    )
    if chosen.orders:
        for name, scene, q, accelerate, rate in linkages:
            print(f"{name}\n\n| order | errors of the crank's angle [rad] | observed order |\n|---|---|---|")
            orders(scene, q, accelerate, rate)
        return
    print("| linkage | error [rad] | contactvi [ms] | DOP853, reduced [ms] | ratio |\n|---|---|---|---|---|")
    for name, scene, q, accelerate, rate in linkages:
        compare(name, scene, q, accelerate, rate, chosen.repeat)


if __name__ == "__main__":
    main()
