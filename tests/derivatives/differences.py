"""Differences of whole runs, and the adjoint beside the tangent."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pinocchio as pin

import contactvi as cvi
from helpers.constrained_scenes import on_constraints

FOURTH = ((-2, 1 / 12), (-1, -8 / 12), (1, 8 / 12), (2, -1 / 12))


def run_differences(
    scene: cvi.Scene, q: np.ndarray, v: np.ndarray, step: float = 2e-4, **options
) -> tuple[np.ndarray, np.ndarray, float]:
    """Fourth-order central differences of (q, v) at the end and of the times of the events in (q0, v0).

    Returns them with their own error, relative, which is what a step of half the length changes.
    """
    first = _differences(scene, q, v, step, options)
    second = _differences(scene, q, v, 0.5 * step, options)
    own = np.abs(first[0] - second[0]).max() / np.abs(second[0]).max()
    return *second, float(own)


def _differences(scene, q, v, step, options) -> tuple[np.ndarray, np.ndarray]:
    nv, base = scene.nv, cvi.simulate(scene, q, v, **options)
    ends, times = np.zeros((2 * nv, 2 * nv)), np.zeros((len(base.events), 2 * nv))
    for k in range(2 * nv):
        for count, weight in FOURTH:
            d = count * step * np.eye(2 * nv)[k]
            traj = cvi.simulate(scene, pin.integrate(scene.model, q, d[:nv]), v + d[nv:], **options)
            assert [event.pair for event in traj.events] == [event.pair for event in base.events]
            end = np.concatenate([pin.difference(scene.model, base.q[-1], traj.q[-1]), traj.v[-1]])
            ends[:, k] += weight / step * end
            times[:, k] += weight / step * np.array([event.time for event in traj.events])
    return ends, times


def constrained_differences(
    scene: cvi.Scene, q: np.ndarray, v: np.ndarray, step: float, **options
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fourth-order differences of the start, of (q, v) at the end and of the times of the events in a scene with
    constraints, along all directions, which are brought back to the constraints.

    The derivative of the run times the first is the second.
    """
    nv, t0 = scene.nv, float(options.get("t0", 0.0))
    base = cvi.simulate(scene, q, v, **options)
    starts, ends = np.zeros((2 * nv, 2 * nv)), np.zeros((2 * nv, 2 * nv))
    times = np.zeros((len(base.events), 2 * nv))
    for k in range(2 * nv):
        for count, weight in FOURTH:
            d = count * step * np.eye(2 * nv)[k]
            start = on_constraints(scene, pin.integrate(scene.model, q, d[:nv]), v + d[nv:], t0)
            traj = cvi.simulate(scene, *start, **options)
            assert [event.pair for event in traj.events] == [event.pair for event in base.events]
            for found, (p, w) in ((starts, start), (ends, (traj.q[-1], traj.v[-1]))):
                first = base.q[0] if found is starts else base.q[-1]
                found[:, k] += weight / step * np.concatenate([pin.difference(scene.model, first, p), w])
            times[:, k] += weight / step * np.array([event.time for event in traj.events])
    return starts, ends, times


def transpose_error(traj: cvi.Trajectory, wrt: list[str], seed: int = 0) -> float:
    """Return the largest difference of the adjoint from the tangent, relative: of a random linear cost of all nodes."""
    rng = np.random.default_rng(seed)
    nodes, nv = len(traj.t), traj.scene.nv
    lq, lv = rng.standard_normal((2, nodes, nv))
    S = traj.sensitivity(wrt)
    value, found = cvi.gradient(traj, (lq, lv), wrt)
    assert value is None
    worst = 0.0
    for name in wrt:
        weights, of_nodes = np.hstack([lq, lv]), S.of(name)
        expected = np.einsum("ni,nik->k", weights, of_nodes)
        got = found[name].sum(axis=0) if name == "control" else found[name]
        # The sum of many terms of both signs may be small. Zero where a friction that sticks does not depend on its
        # coefficient.
        size = float(np.einsum("ni,nik->k", np.abs(weights), np.abs(of_nodes)).max())
        worst = max(worst, float(np.abs(got - expected).max()) / (size if size > 0.0 else 1.0))
    return worst


def compare_parameters(
    traj: cvi.Trajectory, run_of: Callable[[np.ndarray], cvi.Trajectory], x: np.ndarray, names: Sequence[str],
    columns: Sequence[int], bar: float = 1e-7,
) -> None:  # fmt: skip
    """Compare a run's derivatives by parameters of its scene, a column of each, with those of runs with other ones."""
    S = traj.sensitivity(names)
    exact = np.column_stack([S.of(name)[-1][:, k] for name, k in zip(names, columns, strict=True)])

    def end(x: np.ndarray) -> np.ndarray:
        run = run_of(x)
        return np.concatenate([run.q[-1], run.v[-1]])

    for k in range(len(x)):
        step = 1e-4 * max(abs(x[k]), 0.1)
        numbers = sum(weight / step * end(x + count * step * np.eye(len(x))[k]) for count, weight in FOURTH)
        scale = max(np.abs(numbers).max(), 1e-2)
        assert np.abs(exact[:, k] - numbers).max() <= bar * scale, names[k]
