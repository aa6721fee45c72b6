"""Contact laws solved by brute force: every combination of modes is tried, each as a system of equations by Newton.

Unknowns x (any numbers) and the impulses lam (m, 3), rows (normal, two tangents). `function(x)` returns f (nx,) and
w (m, 3), the quantities in the laws (velocities, or gap / h and slip); f(x) = sum of pull_i^T lam_i. Laws of contact i:
  normal       lam_n >= lower, w_n >= 0, (lam_n - lower) w_n = 0
  tangential   |lam_t| <= mu lam_n;  w_t != 0 => lam_t = -mu lam_n w_t/|w_t|; with a direction d: lam_t = -mu lam_n d.
Each contact is "open" (lam_n = lower) or "closed" (w_n = 0), and has one of the tangential modes "none" (lam_t = 0),
"stick" (w_t = 0), "slip", "frozen" (the given d). No claim of uniqueness: `solutions` returns all that it finds.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

Function = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
Mode = tuple[str, str]
CUT = 1e-8  # singular values below it (differences are good to 1e-10) belong to forces that are not unique
SOLVED = 1e-11  # residual of the equations: rounding of a gap over h, 1e-16 m / 1e-4 s, and some


@dataclass(frozen=True)
class Law:
    """Friction mu, lower bound of the normal impulse [N s], direction of the slip (2,) where it is known before."""

    mu: float = 0.0
    lower: float = 0.0
    direction: np.ndarray | None = None

    def modes(self) -> list[Mode]:
        if self.mu == 0.0:
            return [("closed", "none"), ("open", "none")]
        tangential = ["frozen"] if self.direction is not None else ["stick", "slip"]
        closed = [("closed", t) for t in tangential]
        return closed + ([("open", t) for t in tangential] if self.lower > 0.0 else [("open", "none")])


@dataclass(frozen=True)
class Solution:
    """x, lam (m, 3), w (m, 3), the mode of each contact, largest residual."""

    x: np.ndarray
    lam: np.ndarray
    w: np.ndarray
    modes: tuple[Mode, ...]
    residual: float


class Problem:
    """function and laws as above; pull (m, 3, nx); x0 (nx,): where the search starts."""

    def __init__(self, function: Function, pull: np.ndarray, x0: np.ndarray, laws: list[Law]):
        self.function, self.x0, self.laws = function, np.asarray(x0, float), laws
        self.nx, self.m = self.x0.size, len(laws)
        self.pull = np.asarray(pull, float).reshape(3 * self.m, self.nx)
        self._slopes: dict[bytes, np.ndarray] = {}

    def solutions(self, first: tuple[Mode, ...] | None = None, eps: float = 0.0, starts: int = 0) -> Iterator[Solution]:
        """All admissible solutions, at most one for each combination of modes.

        first: the combination to try first. eps: the start of Newton has eps lam added to w, which chooses the
        smallest of the forces that are not unique. starts: number of random directions of slip from which Newton is
        tried where the usual one leads to nothing admissible.
        """
        combinations = list(itertools.product(*(law.modes() for law in self.laws)))
        if first in combinations:
            combinations.remove(first)
            combinations.insert(0, first)
        for modes in combinations:
            for start in self._starts(modes, eps, starts):
                found = self._solve(modes, eps, start)
                if found.residual <= SOLVED and self._admissible(found):
                    yield found
                    break  # other starts of slip may end at the same

    def solve(self, first: tuple[Mode, ...] | None = None, eps: float = 0.0) -> Solution:
        """The first solution found. Raises ArithmeticError where there is none."""
        for starts in (0, 60):
            for solution in self.solutions(first, eps, starts):
                return solution
        raise ArithmeticError("no combination of modes solves the contact problem")

    def _solve(self, modes: tuple[Mode, ...], eps: float, z: np.ndarray) -> Solution:
        if eps:
            z, _ = self._newton(z, modes, eps)
        z, residual = self._newton(z, modes, 0.0)
        lam = z[self.nx :].reshape(-1, 3)
        return Solution(z[: self.nx], lam, self.function(z[: self.nx])[1], modes, residual)

    def _starts(self, modes, eps, count) -> Iterator[np.ndarray]:
        """Starts for Newton. Slip: with given directions, at first without friction and renewed, then random ones."""
        z0 = np.concatenate([self.x0, np.zeros(3 * self.m)])
        slips = [i for i, mode in enumerate(modes) if mode[1] == "slip"]
        if not slips:
            yield z0
            return
        directions = {i: np.zeros(2) for i in slips}
        for _ in range(12):
            z, residual = self._newton(z0, modes, eps, directions)
            w = self.function(z[: self.nx])[1]
            sizes = {i: np.linalg.norm(w[i, 1:]) for i in slips}
            if residual > 1e-6 or min(sizes.values()) < 1e-15:
                break
            old, directions = directions, {i: w[i, 1:] / sizes[i] for i in slips}
            if max(np.abs(directions[i] - old[i]).max() for i in slips) < 1e-3:
                break
        yield z
        rng = np.random.default_rng(0)
        for angles in rng.uniform(-np.pi, np.pi, (count, len(slips))):
            directions = {i: np.array([np.cos(a), np.sin(a)]) for i, a in zip(slips, angles, strict=True)}
            yield self._newton(z0, modes, eps, directions)[0]

    def _system(self, z, modes, eps, directions, slopes):
        """Residual and its matrix; slopes: derivative of (f, w) with respect to x."""
        x, lam, nx = z[: self.nx], z[self.nx :].reshape(-1, 3), self.nx
        f, w = self.function(x)
        w = w + eps * lam
        r, jac = np.zeros(z.size), np.zeros((z.size, z.size))
        r[:nx] = f - self.pull.T @ lam.reshape(-1)
        jac[:nx, :nx], jac[:nx, nx:] = slopes[:nx], -self.pull.T
        dw = np.hstack([slopes[nx:], eps * np.eye(3 * self.m)])  # derivative of w with respect to z
        for i, (normal, tangential) in enumerate(modes):
            law, n, t = self.laws[i], nx + 3 * i, slice(nx + 3 * i + 1, nx + 3 * i + 3)
            if normal == "closed":
                r[n], jac[n] = w[i, 0], dw[3 * i]
            else:
                r[n], jac[n, n] = lam[i, 0] - law.lower, 1.0
            if tangential == "stick":
                r[t], jac[t] = w[i, 1:], dw[3 * i + 1 : 3 * i + 3]
                continue
            d = np.zeros(2)
            if tangential == "frozen":
                d = law.direction
            elif tangential == "slip" and directions is not None:
                d = directions[i]
            elif tangential == "slip":
                size = np.linalg.norm(w[i, 1:]) or np.nan
                d = w[i, 1:] / size
                turn = (np.eye(2) - np.outer(d, d)) / size
                jac[t] = law.mu * lam[i, 0] * turn @ dw[3 * i + 1 : 3 * i + 3]
            r[t] = lam[i, 1:] + law.mu * lam[i, 0] * d
            jac[t, t] += np.eye(2)
            jac[t, n] += law.mu * d
        return r, jac

    def _derivative(self, x):
        """d(f, w)/dx by central differences, (nx + 3m, nx), kept for the other modes."""
        key = x.tobytes()
        if key not in self._slopes:
            columns = []
            for k in range(self.nx):
                d = np.zeros(self.nx)
                d[k] = 1e-5
                up, down = (np.concatenate([a.reshape(-1) for a in self.function(x + s * d)]) for s in (1.0, -1.0))
                columns.append((up - down) / 2e-5)
            self._slopes[key] = np.array(columns).T
        return self._slopes[key]

    def _newton(self, z, modes, eps, directions=None, iterations=40):
        """Newton with minimum-norm steps until it no longer improves; derivatives at x0, renewed every eighth time."""
        slopes = self._derivative(self.x0)
        r, jac, size = self._sized(z, modes, eps, directions, slopes)
        for n in range(1, iterations):
            if size == 0.0 or not np.isfinite(size):
                break
            if n % 8 == 0:
                slopes = self._derivative(z[: self.nx])
                r, jac, size = self._sized(z, modes, eps, directions, slopes)
            step = np.linalg.lstsq(jac, r, rcond=CUT)[0]
            # shorter steps far away, where directions of slip turn; at rounding one more step is enough
            for fraction in (1.0, 0.5, 0.2, 0.05, 0.01) if size > 1e-9 else (1.0,):
                tried = self._sized(z - fraction * step, modes, eps, directions, slopes)
                if tried[2] < size:
                    break
            if not tried[2] < size:
                break
            z, (r, jac, size) = z - fraction * step, tried
        return z, size

    def _sized(self, z, modes, eps, directions, slopes):
        """Residual, matrix and the size of the residual, infinite where it is none."""
        r, jac = self._system(z, modes, eps, directions, slopes)
        good = np.all(np.isfinite(r)) and np.all(np.isfinite(jac))
        return r, jac, float(np.linalg.norm(r)) if good else np.inf

    def _admissible(self, s: Solution) -> bool:
        """Whether the inequalities hold, to a few times the equations."""
        for law, lam, w, (normal, tangential) in zip(self.laws, s.lam, s.w, s.modes, strict=True):
            if (lam[0] < law.lower - 1e-12) if normal == "closed" else (w[0] < -1e-11):
                return False
            if tangential == "stick" and np.linalg.norm(lam[1:]) > law.mu * lam[0] * (1 + 1e-9) + 1e-13:
                return False
            if tangential == "slip" and (np.linalg.norm(w[1:]) < 1e-12 or lam[1:] @ w[1:] > 0.0):
                return False
        return True


def cone_problem(g: np.ndarray, b: np.ndarray, laws: list[Law], first=None, eps: float = 0.0) -> Solution:
    """w = b + G lam under the laws; g (3m, 3m), b (3m,)."""
    problem = Problem(lambda w: (w - b, w.reshape(-1, 3)), g.T, b, laws)
    return problem.solve(first, eps)
