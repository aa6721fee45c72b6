"""The cases of derivative_cases.py measured: exact derivatives beside differences, and the symplectic form of steps."""

from __future__ import annotations

import random
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

import contactvi as cvi
from contactvi.derivatives.gradient_check import Comparison, GradientCheck
from helpers.chains import chain, form, state_of
from helpers.derivative_cases import FAMILIES, ORDERS, Case, tree

BAR = 1e-7  # relative to the largest entry of a column, where the differences' own error allows
SYMPLECTIC = 1e-11  # relative to the form and to A twice


@dataclass
class Row:
    """What was found of a family.

    Attributes:
        cases, impacts: run, and on their way. refused: reason -> count.
        state, times: the comparison with the largest disagreement, of (q, v) and of the times of impacts.
        columns: what to believe -> count. faults: in words.
    """

    family: str
    cases: int = 0
    impacts: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    state: Comparison | None = None
    times: Comparison | None = None
    columns: Counter[str] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)

    def add(self, case: Case, check: GradientCheck) -> None:
        """Take over what was found of a case."""
        self.impacts += len(check.sensitivity.report.events)
        for column in check.columns:
            self.columns[column.believe] += 1
            self.state = _worse(self.state, column.state)
            self.times = _worse(self.times, column.times)
            if column.believe == "neither":
                part = column.worse
                assert part is not None
                self.faults.append(
                    f"{case.family}: {case.label}, {column.name}, {part.what}: {part.relative_difference:.1e} beside "
                    f"{part.relative_own:.1e}, growth {check.sensitivity.report.growth:.2g}"
                )


def _worse(a: Comparison | None, b: Comparison | None) -> Comparison | None:
    """Return the one that disagrees more; what differences cannot tell does not count."""
    if b is None or b.believe(BAR) == "exact":
        return a
    return b if a is None or b.relative_difference > a.relative_difference else a


def sample(cases: list[Case], count: int) -> list[Case]:
    """Return a few cases of each family, always the same."""
    families: dict[str, list[Case]] = defaultdict(list)
    for case in cases:
        families[case.family].append(case)
    rng = random.Random(0)
    return [case for family in families.values() for case in rng.sample(family, min(count, len(family)))]


def examine(case: Case) -> GradientCheck | str:
    """Compare the derivatives of a case with differences; the reason where it has none."""
    scene, q, v = case.make()
    try:
        return cvi.check_gradient(scene, q, v, wrt=case.wrt, columns=case.columns, tolerance=BAR, **case.options)
    except cvi.NotDifferentiable as error:
        return f"{error.reason}: {error.what}"
    except cvi.SimulationError as error:
        return f"the run ended: {error.status.message}"


def measure(cases: Iterable[Case], progress: Callable[[int, str], object] | None = None) -> list[Row]:
    """Return a row per family, in the order of their first cases."""
    rows: dict[str, Row] = {}
    for count, case in enumerate(cases):
        row = rows.setdefault(case.family, Row(case.family))
        if progress is not None:
            progress(count, case.family)
        row.cases += 1
        found = examine(case)
        if isinstance(found, str):
            row.refused[found] += 1
        else:
            row.add(case, found)
    return list(rows.values())


def symplectic_error(joints: str, order: int, seed: int, dt: float = 0.02) -> float:
    """Return the largest entry of A^T J1 A - J0 of a step of momenta, relative to the form and to A twice."""
    scene, rng = tree(seed) if joints == "mixed tree" else chain(FAMILIES[joints], seed)
    q, v, _ = state_of(scene, rng)
    step = cvi.step_derivatives(scene, q, v, None, dt, order=order, state="momentum")
    p = np.asarray(scene.core().momentum(q[None], v[None]))[0]
    before, after = form(scene, p), form(scene, step.x)
    return float(np.abs(step.A.T @ after @ step.A - before).max() / (np.abs(before).max() * np.abs(step.A).max() ** 2))


def symplectic_errors(seeds: int) -> dict[str, float]:
    """Return the largest error of each family of joints over all orders."""
    return {
        joints: max(symplectic_error(joints, order, seed) for order in ORDERS for seed in range(seeds))
        for joints in FAMILIES
    }
