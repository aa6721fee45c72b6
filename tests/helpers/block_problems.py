"""Random contact problems of many bodies: sparse heaps, with robots, joint limits, joint friction, Poisson's bounds.

A block of degrees of freedom has its own mass matrix; a contact acts on one or two of them. Rows (n, t1, t2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from contactvi import _core
from helpers.contact_rows import frame, point_velocity

SAVED = Path(__file__).resolve().parents[1] / "data" / "contact_problems.npz"


@dataclass(frozen=True)
class BlockProblem:
    """M: mass matrices; blocks (m, 2), -1: none; W: per contact (rows, size) of the first and of the second block."""

    M: list[np.ndarray]
    blocks: np.ndarray
    rows: np.ndarray
    mu: np.ndarray
    lower: np.ndarray
    box: np.ndarray
    W: list[list[np.ndarray]]
    v_free: np.ndarray
    offset: np.ndarray
    start: np.ndarray  # impulses of the step before
    equations: np.ndarray | None = None  # (nv, m): equations.T @ v stays what it is in v_free
    turning: np.ndarray | None = None  # (m,): of rows (spin, roll1, roll2) the number of their point; else -1

    @property
    def first_row(self) -> np.ndarray:
        return np.cumsum(self.rows) - self.rows

    @property
    def first_dof(self) -> np.ndarray:
        sizes = [len(M) for M in self.M]
        return np.cumsum(sizes) - sizes

    def dense_mass(self) -> np.ndarray:
        M = np.zeros((len(self.v_free), len(self.v_free)))
        for first, block in zip(self.first_dof, self.M, strict=True):
            M[first : first + len(block), first : first + len(block)] = block
        return M

    def dense_rows(self) -> np.ndarray:
        """(rows, nv)."""
        W = np.zeros((len(self.offset), len(self.v_free)))
        for i, (row, parts) in enumerate(zip(self.first_row, self.W, strict=True)):
            for block, part in zip(self.blocks[i], parts, strict=False):
                first = self.first_dof[block]
                W[row : row + len(part), first : first + part.shape[1]] = part
        return W

    def free_energy(self) -> float:
        return 0.5 * float(self.v_free @ self.dense_mass() @ self.v_free)

    def solver(self) -> _core.BlockContacts:
        return _core.BlockContacts(
            np.array([len(M) for M in self.M], dtype=np.int32),
            np.concatenate([M.ravel() for M in self.M]),
            self.blocks.astype(np.int32),
            self.rows.astype(np.int32),
            self.mu, self.lower, self.box,
            np.concatenate([part.ravel() for parts in self.W for part in parts] or [np.zeros(0)]),
            self.v_free, self.offset, self.equations,
            None if self.turning is None else self.turning.astype(np.int32),
        )  # fmt: skip


def _mass(rng: np.random.Generator, size: int, mass: float) -> np.ndarray:
    if size == 6:
        return np.diag(np.r_[np.full(3, mass), mass * 0.1 * rng.uniform(0.2, 1.0, 3)])
    Q = np.linalg.qr(rng.normal(size=(size, size)))[0]
    return mass * Q @ np.diag(10.0 ** rng.uniform(-1.0, 1.0, size)) @ Q.T


def heap(
    rng: np.random.Generator,
    bodies: int = 6,
    contacts: int = 12,
    *,
    mu: float = 0.8,
    mass_ratio: float = 10.0,
    robots: int = 0,
    redundant: float = 0.0,
    frictionless: float = 0.0,
    bounded: float = 0.0,
    joints: int = 0,
    overlap: float = 0.0,
) -> BlockProblem:
    """Bodies in a cube, contacts between neighbours and with the ground; the last `robots` have 36 degrees of freedom.

    mu: the largest; redundant, frictionless, bounded: shares of contacts that are repeated, of one row, with a lower
    bound; joints: rows of joint friction and of joint limits; overlap [m/s]: of the offsets below zero.
    """
    place = rng.uniform(0.0, 2.0, (bodies, 3))
    sizes = [36 if i >= bodies - robots else 6 for i in range(bodies)]
    masses = mass_ratio ** rng.uniform(-0.5, 0.5, bodies)
    M = [_mass(rng, n, m) for n, m in zip(sizes, masses, strict=True)]
    blocks, rows, mus, lower, box, W = [], [], [], [], [], []

    def side(body: int, arm: np.ndarray, directions: np.ndarray) -> np.ndarray:
        if sizes[body] == 6:
            return directions @ point_velocity(arm)
        return directions @ np.hstack([point_velocity(arm), 0.5 * rng.normal(size=(3, sizes[body] - 6))])

    for _ in range(contacts):
        if W and rng.uniform() < redundant:  # nearly or exactly the contact before, as on the face of a box
            for values in (blocks, rows, mus, lower, box):
                values.append(values[-1])
            W.append([part.copy() for part in W[-1]])
            continue
        a = int(rng.integers(bodies))
        distance = np.linalg.norm(place - place[a], axis=1) + np.where(np.arange(bodies) == a, np.inf, 0.0)
        b = int(np.argsort(distance)[rng.integers(min(3, max(1, bodies - 1)))]) if bodies > 1 else -1
        if b < 0 or rng.uniform() < 0.4:
            directions = frame(np.r_[0.3 * rng.normal(size=2), 1.0])
            blocks.append((a, -1))
            W.append([side(a, -0.5 * directions[0] + 0.1 * rng.normal(size=3), directions)])
        else:
            directions = frame(place[a] - place[b] + 0.1 * rng.normal(size=3))
            blocks.append((a, b))
            W.append([side(a, -0.5 * directions[0], directions), -side(b, 0.5 * directions[0], directions)])
        single = rng.uniform() < frictionless
        rows.append(1 if single else 3)
        if single:
            W[-1] = [part[:1] for part in W[-1]]
        mus.append(0.0 if single or rng.uniform() < 0.1 else rng.uniform(0.1, 1.0) * mu)
        lower.append(rng.uniform(0.0, 1.0) * masses[a] if rng.uniform() < bounded else 0.0)
        box.append(0.0)
    for k in range(joints):
        body = int(rng.integers(bodies))
        row = np.zeros((1, sizes[body]))
        row[0, int(rng.integers(sizes[body]))] = 1.0
        blocks.append((body, -1))
        rows.append(1)
        mus.append(0.0)
        lower.append(0.0)
        box.append(0.0 if k % 3 == 0 else rng.uniform(0.01, 1.0) * masses[body])
        W.append([row])
    v = rng.normal(size=sum(sizes)) * rng.choice([0.05, 1.0])
    first = 0
    for n in sizes:
        v[first + 2] -= rng.uniform(0.0, 1.0)
        first += n
    total = int(np.sum(rows))
    offset, start = np.zeros(total), np.zeros(total)
    for row, count, bound in zip(np.cumsum(rows) - rows, rows, box, strict=True):
        if bound == 0.0:
            offset[row] = rng.uniform() < 0.5 and rng.uniform(0.0, 0.3)
            if rng.uniform() < 0.5:
                offset[row] -= overlap * rng.uniform()
        start[row : row + count] = rng.normal(size=count) * rng.choice([0.0, 0.5])
    return BlockProblem(
        M, np.array(blocks).reshape(-1, 2), np.array(rows), np.array(mus), np.array(lower), np.array(box), W, v,
        offset, start,
    )  # fmt: skip


def with_turning(p: BlockProblem, rng: np.random.Generator, share: float, radius: float) -> BlockProblem:
    """Points with friction get friction against spinning, rolling or both, of radii about this, with this chance."""
    of: list[int] = [-1] * len(p.rows)
    W = list(p.W)
    for i, (rows, mu) in enumerate(zip(p.rows, p.mu, strict=True)):
        if rows != 3 or mu == 0.0 or rng.uniform() >= share:
            continue
        spin, roll = radius * np.exp(rng.uniform(-1.0, 1.0, 2)) * np.array([(1, 1), (1, 0), (0, 1)][rng.integers(3)])
        # The axes of turning are the directions of the rows: those of the velocity of the origin of a body.
        parts = [np.zeros((3, part.shape[1])) for part in p.W[i]]
        for turn, part in zip(parts, p.W[i], strict=True):
            turn[:, 3:6] = np.diag([spin, roll, roll]) @ part[:, :3]
        of.append(i)
        W.append(parts)
    new = len(of) - len(p.rows)
    points = np.array(of[len(p.rows) :], dtype=int)
    zeros, rows = np.zeros(new), np.zeros(3 * new)
    return replace(
        p, blocks=np.vstack([p.blocks, p.blocks[points].reshape(-1, 2)]), rows=np.r_[p.rows, np.full(new, 3)],
        mu=np.r_[p.mu, zeros], lower=np.r_[p.lower, zeros], box=np.r_[p.box, zeros], W=W,
        offset=np.r_[p.offset, rows], start=np.r_[p.start, rows], turning=np.array(of, dtype=int),
    )  # fmt: skip


def heavier(p: BlockProblem, every: int, factor: float) -> BlockProblem:
    return replace(p, M=[M * (factor if i % every == 0 else 1.0) for i, M in enumerate(p.M)])


def read(path: Path) -> list[BlockProblem]:
    """Problems of free bodies in a file: bodies A, B (-1: world) of a contact, rows JA, JB (m, 3, 6), masses M, free
    velocity vf, offset a of the normals, mu, impulses lam0 to start from, each with the problem's number in front."""
    with np.load(path) as file:
        return [_of_arrays({k: file[f"{i}_{k}"] for k in ("A", "B", "JA", "JB", "M", "vf", "a", "mu", "lam0")})
                for i in range(int(file["n"]))]  # fmt: skip


def _of_arrays(z: Mapping[str, Any]) -> BlockProblem:
    m, none = len(z["mu"]), np.zeros(len(z["mu"]))
    offset = np.zeros((m, 3))
    offset[:, 0] = z["a"]
    W = [[JB] if A < 0 else [JB, JA] for A, JA, JB in zip(z["A"], z["JA"], z["JB"], strict=True)]
    return BlockProblem(
        list(z["M"]), np.c_[z["B"], z["A"]], np.full(m, 3), np.array(z["mu"], float), none, none, W,
        np.array(z["vf"], float), offset.ravel(), np.array(z["lam0"], float).ravel(),
    )  # fmt: skip
