"""Rows of the reproduced table that need whole runs: orders, long-run energy, cost, dense impacts, L2 error."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactvi.options import ImpactMap
from contactvi.reproduce.check import Check, about, at_most, between, near, reported
from contactvi.reproduce.reference import reference
from contactvi.reproduce.row import Row, answers, listed, per_map
from contactvi.reproduce.systems import (
    ABSOLUTE,
    DURATION,
    GRAVITY,
    MAPS,
    START,
    STEPS,
    ball,
    run_b,
    stepper,
)
from contactvi.simulation.simulation import simulate
from contactvi.trajectory.trajectory import Trajectory

Array = NDArray[np.float64]
Advance = Callable[[float], object]  # called with the fraction of the work that is done

LONG = 1000.0  # [s]
LONG_STEP = 0.02  # [s]
HEIGHTS = (1.0, 0.1, 0.01, 0.001)  # [m]
BALL_STEP, BALL_DURATION = 0.01, 100.0  # [s]
L2_STEP = 0.02  # [s]
_SEED = 20260
_SPREAD = 0.1  # [rad] around the start of problem B

# An earlier measurement of the claims on the same problem with another code.
_ORDERS = {"ctec": (1.96, 1.99, 2.00, 2.00), "dtec": (2.12, 1.94, 1.84, 2.16), "mhc": (1.96, 1.99, 2.00, 2.00)}
_DENSE_DTEC = (4e-4, 1.2e-3, 1.3e-2, 0.21)
_COST: dict[ImpactMap, float] = {"dtec": 1.7, "mhc": 3.3}
# DTEC's energy drifts in either direction: shifts of the start by 1e-12 rad give decile means of -0.086 .. 0.060 J,
# which its range includes.
_LONG_RANGES = {"ctec": (-6e-5, 2e-4), "dtec": (-1.2e-1, 1.2e-1), "mhc": (6.65e-4, 7.55e-4)}
_EVEN = 0.02  # scatter of an error that falls evenly
_SAME_ORDER = 0.9  # least share of the starts for which a ranking has to hold


@dataclass(frozen=True)
class Convergence:
    """Errors of problem B against the reference over steps h (n,) [s], one array per map.

    Attributes:
        error: |q(3) - ref| [rad].
    """

    h: Array
    error: dict[str, Array]


def convergence(steps: Array, advance: Advance | None = None) -> Convergence:
    """Run problem B with every map and step."""
    exact = reference(START, np.array([0.0, DURATION]))
    error: dict[str, list[float]] = {name: [] for name in MAPS}
    for k, h in enumerate(steps):
        for name in MAPS:
            traj = run_b(name, float(h))
            error[name].append(float(np.linalg.norm(ABSOLUTE @ traj.q[-1] - exact.q[-1])))
        if advance is not None:
            advance((k + 1) / len(steps))
    return Convergence(np.asarray(steps, dtype=float), {name: np.array(values) for name, values in error.items()})


def structured_row(data: Convergence, fine: Convergence) -> Row:
    """Orders of |q(3) - ref| from halving to halving, `data` at STEPS; how evenly it falls, `fine` at many steps."""
    orders = {name: np.log2(data.error[name][:-1] / data.error[name][1:]) for name in MAPS}
    scatter = {name: unevenness(fine, name) for name in MAPS}
    checks = []
    for name in MAPS:
        checks += [
            reported("|q(3) - ref|", x).of(name, f"h = {h:g} s", "rad")
            for h, x in zip(STEPS, data.error[name], strict=True)
        ]
        for h, found, known in zip(STEPS[1:], orders[name], _ORDERS[name], strict=True):
            reason = "two decimals are known: half a unit, and the 0.001 by which another machine may differ"
            checks.append(near("order", known, found, 0.006, reason).of(name, f"h = {2 * h:g} to {h:g} s", "1"))
        steps = f"{len(fine.h)} steps"
        checks.append(reported("scatter of the error about its curve", scatter[name]).of(name, steps, "1"))
    return Row(
        key="structured convergence",
        claim="The error falls evenly with the step, with the order 2 of the integrator",
        paper=("yes", "no", "yes"),
        found=answers(np.abs(orders[name] - 2.0).max() <= 0.05 and scatter[name] <= _EVEN for name in MAPS),
        measured="orders "
        + per_map({name: listed(orders[name], ".2f") for name in MAPS})
        + "; scatter "
        + per_map({name: f"{100 * scatter[name]:.1f} %" for name in MAPS}),
        expected=per_map({name: listed(_ORDERS[name], ".2f") for name in MAPS}),
        rule=f"yes where each order is 2 +- 0.05 and the error at many steps scatters by {100 * _EVEN:g} % at most "
        "about a smooth curve; numbers to two decimals (+- 0.006)",
        checks=checks,
        note=f"DTEC has order 2 on the average (mean {orders['dtec'].mean():.2f}): its error at an impact depends on "
        "where in the step the impact lies. The curve is a cubic in log h for log (error / h^2).",
    )


def unevenness(data: Convergence, name: str) -> float:
    """Return the standard deviation of error / h^2 about a smooth curve over h, as a share of it."""
    x, y = np.log(data.h), np.log(data.error[name] / data.h**2)
    return float(np.std(y - np.polyval(np.polyfit(x - x.mean(), y, 3), x - x.mean())))


@dataclass(frozen=True)
class LongRun:
    """H - H(0) [J] at the nodes t [s] of a long run, per map; deciles: their means over tenths of the run.

    Attributes:
        fallbacks: how many of the impacts the map had no answer for, so that CTEC's was taken.
    """

    t: Array
    energy: dict[str, Array]
    impacts: dict[str, int]
    fallbacks: dict[str, int]

    @property
    def deciles(self) -> dict[str, Array]:
        return {
            name: np.array([part.mean() for part in np.array_split(values[1:], 10)])
            for name, values in self.energy.items()
        }


def long_run() -> LongRun:
    """Run problem B for 1000 s."""
    runs = {name: run_b(name, LONG_STEP, LONG) for name in MAPS}
    return LongRun(
        runs["ctec"].t,
        {name: traj.energy - traj.energy[0] for name, traj in runs.items()},
        {name: len(traj.events) for name, traj in runs.items()},
        {name: _fallbacks(traj) for name, traj in runs.items()},
    )


def _fallbacks(traj: Trajectory) -> int:
    return int(np.count_nonzero(traj.events.array("fallback")))


def _no_fallbacks(count: int, name: str, case: str) -> Check:
    """Expect that the map solved every impact of a run itself."""
    return at_most("impacts left to CTEC", 0.0, count, "every impact has a root").of(name, case, "1")


def long_run_row(data: LongRun) -> Row:
    """Long-run energy: the spread of the decile means."""
    deciles = data.deciles
    spread = {name: float(np.ptp(values)) for name, values in deciles.items()}
    checks = []
    for name in MAPS:
        impacts = near("impacts", 707.0, data.impacts[name], 14.0, "2 %: the motion is chaotic")
        checks += [impacts.of(name, "1000 s", "1"), _no_fallbacks(data.fallbacks[name], name, "1000 s")]
        for k, value in enumerate(deciles[name]):
            mean = between("decile mean of H - H(0)", *_LONG_RANGES[name], value, "what shifted starts give")
            checks.append(mean.of(name, f"tenth {k + 1}", "J"))
        checks.append(reported("spread of the decile means", spread[name]).of(name, "1000 s", "J"))
    others = {name: min(value for other, value in spread.items() if other != name) for name in MAPS}
    return Row(
        key="long-run energy",
        claim="Over a long run, that of Fig. 1, MHC's energy does not drift",
        paper=("no", "no", "yes"),
        found=answers(spread[name] <= others[name] / 3.0 for name in MAPS),
        measured="decile means: "
        + per_map({name: f"{values.min():.1e} .. {values.max():.1e} J" for name, values in deciles.items()})
        + f"; {data.impacts['ctec']} impacts",
        expected="MHC 7.0e-4 .. 7.2e-4 (flat), CTEC -3e-5 .. 1e-4, DTEC drifts (-6e-2 .. 6e-2); about 707 impacts",
        rule="yes where the spread of a map's decile means is <= 1/3 of either other's; MHC's means within 5 %, the "
        "others' range widened by a factor 2 (the motion is chaotic), impacts within 2 %",
        checks=checks,
        note=f"h = {LONG_STEP:g} s, 1000 s. Spreads: "
        + per_map({name: f"{spread[name]:.1e} J" for name in MAPS})
        + ". MHC's offset is of order h^2: it keeps the modified energy, and H stays about it.",
    )


def cost_row(repeats: int, advance: Advance | None = None) -> Row:
    """Wall time of a step with an impact: fastest of `repeats`, mean over the 6 such steps of three runs of B."""
    times: dict[str, list[float]] = {name: [] for name in MAPS}
    evaluations: dict[str, float] = {}
    smooth = []
    for k, h in enumerate(STEPS[:3]):
        for name in MAPS:
            traj = run_b(name, h)
            core, simulator = traj.scene.core(), stepper(traj.scene, name, h)
            evaluations[name] = float(traj.events.array("iterations").mean())
            for step in traj.events.array("step"):
                q, p = traj.q[step - 3], traj.p[step - 3]
                v = np.asarray(core.velocity(q[None], p[None]))[0]
                samples = np.zeros((repeats, 2))
                for r in range(repeats):
                    simulator.reset(q, v)
                    seconds = []
                    for _ in range(4):  # two steps to get warm, one smooth, the one with the impact
                        simulator.step()
                        seconds.append(simulator.trajectory().stats.seconds)
                    samples[r] = seconds[2] - seconds[1], seconds[3] - seconds[2]
                times[name].append(float(samples[:, 1].min()))
                smooth.append(float(samples[:, 0].min()))
        if advance is not None:
            advance((k + 1) / 3)
    mean = {name: 1e6 * float(np.mean(values)) for name, values in times.items()}
    ratio = {name: mean[name] / mean["ctec"] for name in MAPS}
    checks = [reported("time of a step with an impact", mean[name]).of(name, "6 impacts", "us") for name in MAPS]
    checks += [
        about("time / CTEC's", _COST[name], ratio[name], 1.25, "another machine").of(name, "6 impacts", "1")
        for name in _COST
    ]
    places = dict(zip(sorted(mean, key=lambda name: mean[name]), ("least", "more", "most"), strict=True))
    return Row(
        key="cost",
        claim="A step with an impact costs least with CTEC, more with DTEC, most with MHC",
        paper=("least", "more", "most"),
        found=tuple(places[name] for name in MAPS),
        measured=per_map({name: f"{mean[name]:.1f} us" for name in MAPS})
        + f"; 1 : {ratio['dtec']:.1f} : {ratio['mhc']:.1f}",
        expected="CTEC < DTEC < MHC, near 1 : 1.7 : 3.3",
        rule="by the mean times; the ratios within 25 %",
        checks=checks,
        note="Time inside the engine, event location included: it costs every map the same and draws the ratios "
        f"together. Above CTEC: DTEC {mean['dtec'] - mean['ctec']:.1f} us for {evaluations['dtec']:.1f} evaluations of "
        f"its scalar, MHC {mean['mhc'] - mean['ctec']:.1f} us for {evaluations['mhc']:.1f} (h = {STEPS[2]:g} s). A "
        f"step beside the wall without impact takes {1e6 * float(np.mean(smooth)):.1f} us.",
    )


@dataclass(frozen=True)
class Dense:
    """Energy error (H - H(0)) / (m g height) of the ball at times t [s]: errors[map][k] from HEIGHTS[k].

    Attributes:
        impacts, fallbacks: their numbers likewise, the latter of impacts where CTEC's answer was taken.
    """

    t: Array
    errors: dict[str, list[Array]]
    impacts: dict[str, list[int]]
    fallbacks: dict[str, list[int]]


def dense_runs() -> Dense:
    """Let the ball bounce for 100 s from every height with every map."""
    errors: dict[str, list[Array]] = {name: [] for name in MAPS}
    impacts: dict[str, list[int]] = {name: [] for name in MAPS}
    fallbacks: dict[str, list[int]] = {name: [] for name in MAPS}
    for height in HEIGHTS:
        scene = ball(height)
        for name in MAPS:
            traj = simulate(
                scene, scene.neutral(), np.zeros(6), duration=BALL_DURATION, dt=BALL_STEP, impact=name, solver_tol=1e-13
            )
            errors[name].append((traj.energy - traj.energy[0]) / (GRAVITY * height))
            impacts[name].append(len(traj.events))
            fallbacks[name].append(_fallbacks(traj))
    return Dense(traj.t, errors, impacts, fallbacks)


def dense_row(data: Dense) -> Row:
    """Energy error of dense impacts."""
    largest = {name: [float(np.abs(x).max()) for x in data.errors[name]] for name in MAPS}
    checks = []
    for name in MAPS:
        for k, height in enumerate(HEIGHTS):
            what, drop = "largest relative energy error", f"drop {height:g} m"
            if name == "dtec":
                error = about(what, _DENSE_DTEC[k], largest[name][k], 2.0, "two digits of an earlier measurement")
            else:
                error = at_most(what, 1e-11, largest[name][k], "rounding over some 1e4 impacts")
            checks += [error.of(name, drop, "1"), _no_fallbacks(data.fallbacks[name][k], name, drop)]
    return Row(
        key="dense impacts",
        claim="Where impacts are dense, the energy is kept",
        paper=("yes", "no", "yes"),
        found=answers(max(largest[name]) <= 1e-11 for name in MAPS),
        measured="drop 1, .1, .01, .001 m: " + per_map({name: listed(largest[name], ".1e") for name in MAPS}),
        expected="CTEC, MHC <= 1e-11; DTEC " + listed(_DENSE_DTEC, ".1e"),
        rule="yes where the largest error is <= 1e-11 from every height; DTEC's numbers within a factor 2",
        checks=checks,
        note=f"Elastic ball, h = {BALL_STEP:g} s, {BALL_DURATION:g} s, CTEC's "
        + ", ".join(str(n) for n in data.impacts["ctec"])
        + " impacts. On this ball MHC is CTEC.",
    )


def l2_errors(starts: int, advance: Advance | None = None) -> tuple[Array, Array]:
    """Return random starts near problem B's, (n, 2) [rad], and the L2 errors of the maps over 3 s, (n, 3) [rad]."""
    rng = np.random.default_rng(_SEED)
    start = START + rng.uniform(-_SPREAD, _SPREAD, (starts, 2))
    times = np.arange(round(DURATION / L2_STEP) + 1) * L2_STEP
    errors = np.zeros((starts, len(MAPS)))
    for k in range(starts):
        exact = reference(start[k], times, rtol=1e-11)
        for j, name in enumerate(MAPS):
            gap = run_b(name, L2_STEP, DURATION, start[k]).q @ ABSOLUTE.T - exact.q
            errors[k, j] = np.sqrt(np.mean(np.sum(gap**2, axis=1)))
        if advance is not None:
            advance((k + 1) / starts)
    return start, errors


def l2_row(errors: Array) -> Row:
    """Ranking of the maps by L2 error, reported: no map is expected to be first."""
    n = len(errors)
    median = np.median(errors, axis=0)
    best = [float(np.mean(errors.argmin(axis=1) == k)) for k in range(len(MAPS))]
    ranking, count = Counter(map(tuple, errors.argsort(axis=1).tolist())).most_common(1)[0]
    apart = float(median.max() / median.min() - 1.0)
    starts = f"{n} starts"
    checks = [reported("median L2 error", median[k]).of(name, starts, "rad") for k, name in enumerate(MAPS)]
    checks += [
        reported("share of starts in which it is best", best[k]).of(name, starts, "1") for k, name in enumerate(MAPS)
    ]
    checks.append(reported("medians apart", apart).of("", starts, "1"))
    order = " < ".join(MAPS[k].upper() for k in ranking)
    rank = errors.argsort(axis=1).argsort(axis=1)
    shares = np.array([[np.mean(rank[:, k] == place) for place in range(len(MAPS))] for k in range(len(MAPS))])
    return Row(
        key="L2 error",
        claim="The maps rank highest, mid, lowest by L2 error",
        paper=("highest", "mid", "lowest"),
        found=tuple(
            ("lowest", "mid", "highest")[int(own.argmax())] if own.max() >= _SAME_ORDER else "varies" for own in shares
        ),
        measured="medians "
        + per_map({name: f"{median[k]:.2e}" for k, name in enumerate(MAPS)})
        + f" rad ({100 * apart:.0f} % apart); best: "
        + per_map({name: f"{100 * best[k]:.0f} %" for k, name in enumerate(MAPS)}),
        expected="reported, nothing is asserted: medians within about 10 %, CTEC often best",
        rule=f"a map has a place where it has it in {100 * _SAME_ORDER:.0f} % of the starts, else it varies",
        checks=checks,
        note=f"{n} starts within {_SPREAD:g} rad of problem B's, h = {L2_STEP:g} s, root mean square over the nodes. "
        f"The most frequent ranking, {order}, is that of {100 * count / n:.0f} % of them; the paper itself blames "
        "the initial condition.",
    )
