"""Contact problems as the steps of runs pose them, with the rows of constraints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

import contactvi as cvi
from helpers.block_problems import BlockProblem

RANK = 1e-13  # of the largest eigenvalue of G: smaller ones are rounding


def record(
    scene: cvi.Scene, q: np.ndarray, v: np.ndarray, duration: float, dt: float, mode: str, count: int = 0
) -> list[BlockProblem]:
    """Of each step of a run the first problem with contacts; evenly chosen ones where there are more than `count` > 0.

    mode: "steps" for those of dense steps, "events" for those of contact steps.
    """
    simulator = cvi.Simulator(scene, dt, contact_mode=mode, dense=True, record=False)
    simulator.reset(q, v)
    assert simulator._run is not None
    engine = simulator._run._engine
    engine.keep_problems()
    found = []
    for _ in range(round(duration / dt)):
        going_on = simulator.step().code == cvi.StatusCode.SUCCESS
        posed = engine.take_problems()
        problems = [of_dense(d) for d in posed["dense"]] + [of_contact(d) for d in posed["contact"] if _plain(d)]
        found += [p for p in problems if (p.box == 0.0).any() and not p.lower.any()][:1]
        if not going_on:
            break
    if 0 < count < len(found):
        found = [found[i] for i in np.linspace(0, len(found) - 1, count).astype(int)]
    return found


def _plain(posed: Mapping[str, Any]) -> bool:
    """No contact has a given direction of friction."""
    return bool(np.isnan(posed["frozen"]).all())


def of_dense(posed: Mapping[str, Any]) -> BlockProblem:
    """That of a dense step."""
    sizes, rows, blocks = (np.asarray(posed[name]).astype(int) for name in ("sizes", "rows", "blocks"))
    parts = np.split(posed["masses"], np.cumsum(sizes**2)[:-1])
    M = [part.reshape(n, n) for part, n in zip(parts, sizes, strict=True)]
    W, read = [], 0
    for count, pair in zip(rows, blocks, strict=True):
        W.append([])
        for block in pair[pair >= 0]:
            size = count * sizes[block]
            W[-1].append(np.asarray(posed["W"])[read : read + size].reshape(count, sizes[block]))
            read += size
    names = ("mu", "lower", "box")
    return BlockProblem(
        M, blocks, rows, *(posed[name] for name in names), W, posed["v_free"], posed["offset"], posed["start"],
        posed["equations"],
    )  # fmt: skip


def of_contact(posed: Mapping[str, Any]) -> BlockProblem:
    """That of a contact step, by `of_rows`."""
    names = ("rows", "mu", "lower", "box")
    rows, mu, lower, box = (np.asarray(posed[name]) for name in names)
    return of_rows(posed["G"], posed["b"], rows.astype(int), mu, lower, box, posed["start"], posed["equations"])


def of_rows(
    G: np.ndarray, b: np.ndarray, rows: np.ndarray, mu: np.ndarray, lower: np.ndarray, box: np.ndarray,
    start: np.ndarray, equations: int,
) -> BlockProblem:  # fmt: skip
    """Of w = b + G lambda, as one block with unit masses; the first rows are equations w = 0.

    Of G the symmetric part is taken: that of a contact step is not symmetric, by O(h).
    """
    values, vectors = np.linalg.eigh(0.5 * (G + G.T))
    keep = values > RANK * values.max(initial=0.0)
    L = vectors[:, keep] * np.sqrt(values[keep])
    v = np.linalg.lstsq(L, b, rcond=None)[0]
    offset = (b - L @ v)[equations:]
    A, W = L[:equations], L[equations:]
    if equations:
        v = v - np.linalg.lstsq(A, A @ v, rcond=RANK**0.5)[0]
    W_of = [[part] for part in np.split(W, np.cumsum(rows)[:-1])]
    blocks = np.c_[np.zeros(len(rows), int), np.full(len(rows), -1)]
    return BlockProblem(
        [np.eye(L.shape[1])], blocks, rows, mu, lower, box, W_of, v, offset, np.asarray(start)[equations:], A.T
    )
