"""The woodpecker toy in the plane: events located, limit cycle to many digits; and Moreau's steps for comparison.

Glocker, Pfeiffer, "Multiple impacts with friction in rigid multibody systems", Nonlinear Dynamics 7 (1995); Glocker,
Studer (2005). The numbers are Glocker's; the equations are linear in the angles, as in those papers.

Coordinates. y is the height of the sleeve's centre, phi_M the angle of the sleeve, phi_S that of the woodpecker, both
counterclockwise and small. The sleeve M (mass m_M, inertia J_M about its centre) slides on a vertical pole of radius
r_0 with a hole of radius r_M and half height h_M. A hinge at the distance l_M from its centre, to the right, carries
the bird S by a torsion spring c (without torque where phi_M = phi_S); the bird's centre of mass (m_S, J_S) is l_G
further right, and its beak reaches back to the pole: l_S left of the bird's centre and h_S above it. With small angles:

    velocity of the sleeve's centre   (0, y')
    velocity of the bird's centre     y' + l_M phi_M' + l_G phi_S', vertical; horizontal motion is left out
    M = [[m_S + m_M, m_S l_M,           m_S l_G          ],
         [m_S l_M,   J_M + m_S l_M^2,   m_S l_M l_G      ],
         [m_S l_G,   m_S l_M l_G,       J_S + m_S l_G^2  ]]
    h = [-(m_S + m_M) g, -c (phi_M - phi_S) - m_S l_M g, -c (phi_S - phi_M) - m_S l_G g]
    M u' = h + sum of W_N lambda_N + W_T lambda_T

    gaps  beak    g1 = l_M + l_G - l_S - r_0 - h_S phi_S      W_N = (0, 0, -h_S)   W_T = (1, l_M, l_G - l_S)
          lower   g2 = r_M - r_0 + h_M phi_M                  W_N = (0, h_M, 0)    W_T = (1, r_M, 0)
          upper   g3 = r_M - r_0 - h_M phi_M                  W_N = (0, -h_M, 0)   W_T = (1, r_M, 0)

W_T gives the vertical velocity of the touching point, the pole being at rest. Newton's restitution e = (1/2, 0, 0) and
Coulomb friction of 0.3 on the slip after an impact, all closed contacts at once (one complementarity problem). The
sideways motion of the bodies has neither inertia nor gap here: a model of joints needs the vertical joint y, the two
hinges, and these three contacts with the angles' sine and cosine, and differs by terms of second order in the angles.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import brentq

from . import planar_impacts
from .event_ode import leg

R0, RM, HM, LM, LG, HS, LS = 0.0025, 0.0031, 0.0058, 0.010, 0.015, 0.020, 0.0201
MASS_M, MASS_S, J_M, J_S, SPRING, GRAVITY = 3e-4, 4.5e-3, 5e-9, 7e-7, 0.0056, 9.81
MU, RESTITUTION = 0.3, (0.5, 0.0, 0.0)
Q0, U0 = (0.0, -0.1036, -0.2788), (-0.3411, 0.0, -7.4583)

MASS = np.array(
    [
        [MASS_S + MASS_M, MASS_S * LM, MASS_S * LG],
        [MASS_S * LM, J_M + MASS_S * LM**2, MASS_S * LM * LG],
        [MASS_S * LG, MASS_S * LM * LG, J_S + MASS_S * LG**2],
    ]
)
W_N = np.array([[0.0, 0.0, -HS], [0.0, HM, 0.0], [0.0, -HM, 0.0]])
W_T = np.array([[1.0, LM, LG - LS], [1.0, RM, 0.0], [1.0, RM, 0.0]])
GAP0 = np.array([LM + LG - LS - R0, RM - R0, RM - R0])
INVERSE = np.linalg.inv(MASS)
ZERO = 1e-12  # speeds [m/s] below this are none


def force(q: np.ndarray) -> np.ndarray:
    """h: weight and spring."""
    twist = SPRING * (q[1] - q[2])
    weight = GRAVITY * np.array([MASS_S + MASS_M, MASS_S * LM, MASS_S * LG])
    return np.array([0.0, -twist, twist]) - weight


def gaps(q: np.ndarray) -> np.ndarray:
    """Gaps of the beak, the lower and the upper edge of the sleeve."""
    return GAP0 + W_N @ q


def energy(q: np.ndarray, u: np.ndarray) -> float:
    """Kinetic energy and that of the spring and of weight."""
    height = (MASS_S + MASS_M) * q[0] + MASS_S * (LM * q[1] + LG * q[2])
    return float(0.5 * u @ MASS @ u + 0.5 * SPRING * (q[1] - q[2]) ** 2 + GRAVITY * height)


def complementarity(
    free: np.ndarray, closed: list[int], normal: np.ndarray, signs: dict[int, float]
) -> tuple[np.ndarray, dict[int, tuple[str, float, float]]]:
    """(velocity or acceleration, {contact: (mode, normal, tangential multiplier)}) of contacts with Coulomb friction.

    free: without contact. normal[i]: what the normal one of contact i becomes. signs: of a slip that is there already.
    Every combination of open, stick and slip is tried; the first that is consistent is the answer.
    """
    scale = 1e-11 * max(1.0, float(np.abs(W_N @ free).max()), float(np.abs(W_T @ free).max()))
    options = [
        ("open", "up" if signs[i] > 0 else "down") if i in signs else ("open", "stick", "up", "down") for i in closed
    ]
    for modes in itertools.product(*options):
        rows, target, columns, who = [], [], [], []
        for i, mode in zip(closed, modes, strict=True):
            if mode == "open":
                continue
            rows.append(W_N[i])
            target.append(normal[i])
            who.append((i, mode))
            if mode == "stick":
                columns += [W_N[i], W_T[i]]
                rows.append(W_T[i])
                target.append(0.0)
            else:
                columns.append(W_N[i] - MU * (1.0 if mode == "up" else -1.0) * W_T[i])
        after, lam = free, np.zeros(0)
        if rows:
            a, b = np.array(rows), np.array(columns)
            lam = np.linalg.solve(a @ INVERSE @ b.T, np.array(target) - a @ free)
            after = free + INVERSE @ b.T @ lam
        good, at, found = True, 0, dict.fromkeys(closed, ("open", 0.0, 0.0))
        for i, mode in who:
            n = lam[at]
            if mode == "stick":
                t = lam[at + 1]
                good = good and abs(t) <= MU * n
            else:
                sign = 1.0 if mode == "up" else -1.0
                t = -MU * sign * n
                good = good and (i in signs or sign * float(W_T[i] @ after) >= -scale)
            good = good and n >= 0.0
            found[i] = (mode, float(n), float(t))
            at += 2 if mode == "stick" else 1
        for i, mode in zip(closed, modes, strict=True):
            good = good and (mode != "open" or float(W_N[i] @ after) >= normal[i] - scale)
        if good:
            return after, found
    raise ArithmeticError("no consistent modes")


def impact(u: np.ndarray, touching: list[int], law: str) -> tuple[np.ndarray, str]:
    """(velocity, what happened) after an impact of the contacts that touch.

    law "together": Newton's restitution in one problem. Any law of `planar_impacts` ("two_phase" is Poisson's): the
    beak alone while it closes, then the others, which are plastic, in one problem; until none closes. With "two_phase"
    and "complementarity" the cycle is the same to the last digit, since the beak slips the same way in both phases;
    with the incremental laws the slip turns in the impact, and no cycle of one beat was seen.
    """
    if law == "together":
        normal = np.array([-e * v for e, v in zip(RESTITUTION, W_N @ u, strict=True)])
        u, found = complementarity(u, touching, normal, {})
        return u, ", ".join(f"{i} {mode}" for i, (mode, _, _) in found.items())
    text = []
    for _ in range(100):
        speeds = W_N @ u
        elastic = [i for i in touching if RESTITUTION[i] > 0.0 and speeds[i] < -ZERO]
        plastic = [i for i in touching if RESTITUTION[i] == 0.0]
        if elastic:
            rows = np.array([W_N[elastic[0]], W_T[elastic[0]]])
            found = planar_impacts.solve(rows @ INVERSE @ rows.T, rows @ u, MU, RESTITUTION[elastic[0]], law)
            u, name = u + INVERSE @ rows.T @ found.impulse, f"{elastic[0]} {found.phases}"
        elif plastic and speeds[plastic].min() < -ZERO:
            u, modes = complementarity(u, plastic, np.zeros(3), {})
            name = ", ".join(f"{i} {mode}" for i, (mode, _, _) in modes.items())
        else:
            break
        text.append(name)
    return u, "; ".join(text)


@dataclass
class Motion:
    """What happened: [(t, q, u, text)], and the smooth pieces (t0, t1, state as a function of time)."""

    log: list[tuple[float, np.ndarray, np.ndarray, str]] = field(default_factory=list)
    pieces: list[tuple[float, float, object]] = field(default_factory=list)

    def state(self, t: float) -> np.ndarray:
        """(q, u) at time t, by the interpolation of the integrator."""
        return next(dense(t) for start, end, dense in self.pieces if start <= t <= end)


def _project(q: np.ndarray, u: np.ndarray, closed: list[int], stuck: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Remove rounding from the gaps and the velocities that are zero."""
    if closed:
        w = W_N[closed]
        q = q - w.T @ np.linalg.solve(w @ w.T, gaps(q)[closed])
        w = np.concatenate([w, W_T[stuck]])
        u = u - w.T @ np.linalg.solve(w @ w.T, w @ u)
    return q, u


def run(
    t_end: float,
    q: np.ndarray = Q0,
    u: np.ndarray = U0,
    until: str | None = None,
    law: str = "together",
    most: int = 100_000,
) -> Motion:
    """Events located: impacts, ends of contact, of slip and of stick. A gap <= 0 at the start is closed."""
    t, q, u, motion = 0.0, np.array(q, float), np.array(u, float), Motion()
    touching, begun = [i for i in range(3) if gaps(q)[i] <= 1e-13], {}
    motion.log.append((t, q, u, "start"))
    for _ in range(most):
        speeds = W_N[touching] @ u
        if touching and speeds.min() < -ZERO:
            u, text = impact(u, touching, law)
            motion.log.append((t, q, u, f"impact {text}"))
        closed = [i for i in touching if abs(W_N[i] @ u) <= ZERO]
        signs = {i: float(np.sign(W_T[i] @ u)) for i in closed if abs(W_T[i] @ u) > ZERO} | begun
        _, found = complementarity(INVERSE @ force(q), closed, np.zeros(3), signs)
        modes = {i: mode for i, (mode, _, _) in found.items() if mode != "open"}
        closed, stuck = list(modes), [i for i, mode in modes.items() if mode == "stick"]
        q, u = _project(q, u, closed, stuck)
        rows = np.array([W_N[i] for i in closed] + [W_T[i] for i in stuck]).reshape(-1, 3)
        slope = {i: 0.0 if mode == "stick" else -MU * (1.0 if mode == "up" else -1.0) for i, mode in modes.items()}
        columns = np.array([W_N[i] + slope[i] * W_T[i] for i in closed] + [W_T[i] for i in stuck]).reshape(-1, 3)
        delassus = rows @ INVERSE @ columns.T

        def multipliers(q, rows=rows, delassus=delassus):
            return -np.linalg.solve(delassus, rows @ INVERSE @ force(q)) if len(rows) else np.zeros(0)

        def rhs(t, y, columns=columns, multipliers=multipliers):
            return np.concatenate([y[3:], INVERSE @ (force(y[:3]) + columns.T @ multipliers(y[:3]))])

        events, names = [], []
        for i in range(3):
            if i not in modes:  # the small offset keeps a contact that has just opened from closing by rounding
                events.append((lambda t, y, i=i: gaps(y[:3])[i] + 1e-14, -1))
                names.append(("closes", i))
        for at, i in enumerate(closed):
            events.append((lambda t, y, at=at, f=multipliers: f(y[:3])[at], -1))
            names.append(("opens", i))
            if i in stuck:
                k = len(closed) + stuck.index(i)
                for s in (1.0, -1.0):
                    f = lambda t, y, at=at, k=k, s=s, f=multipliers: MU * f(y[:3])[at] - s * f(y[:3])[k]  # noqa: E731
                    events.append((f, -1))
                    names.append(("slips up" if s < 0.0 else "slips down", i))
            else:
                sign = 1.0 if modes[i] == "up" else -1.0
                events.append((lambda t, y, i=i, s=sign: s * float(W_T[i] @ y[3:]), -1))
                names.append(("slip ends", i))
        done = leg(rhs, t, np.concatenate([q, u]), t_end, events)
        motion.pieces.append((t, done.t, done.dense))
        t, q, u = done.t, done.y[:3].copy(), done.y[3:].copy()
        q, u = _project(q, u, closed, stuck)
        if done.event is None:
            motion.log.append((t, q, u, "end"))
            return motion
        name, i = names[done.event]
        motion.log.append((t, q, u, f"{i} {name}"))
        if motion.log[-1][3] == until and t > 1e-9:
            return motion
        # A stick that has just ended must not be found again: its friction is at the bound.
        begun = {i: 1.0 if name == "slips up" else -1.0} if name.startswith("slips") else {}
        touching = [j for j in closed if (name, j) != ("opens", i)]
        if name == "closes":
            touching = sorted([*touching, i])
            q, _ = _project(q, u, [i], [])
        elif name == "slip ends":
            u = _project(q, u, closed, [*stuck, i])[1]
    raise ArithmeticError("too many events")


def limit_cycle(turn: tuple[float, float] = (17.55, 17.61)) -> tuple[float, float, float, Motion]:
    """(period, drop, multiplier, one period of the motion) of the limit cycle.

    It starts where the sleeve, held by the lower edge alone, begins to slip: all of q but the height and all of u but
    phi_S' are fixed there, so the return map is one of phi_S' alone. `turn` brackets its fixed point.
    """
    first = next((q, u) for _, q, u, text in run(0.1).log if text == "1 slips down")

    def once(rate: float) -> Motion:
        return run(0.3, np.array([0.0, *first[0][1:]]), np.array([0.0, 0.0, rate]), until="1 slips down")

    def miss(rate: float) -> float:
        return float(once(rate).log[-1][2][2]) - rate

    rate = brentq(miss, *turn, xtol=1e-14, rtol=1e-15)
    slope = 1.0 + (miss(rate + 1e-4) - miss(rate - 1e-4)) / 2e-4
    motion = once(rate)
    t, q, _, _ = motion.log[-1]
    return t, -float(q[0]), slope, motion


def moreau(t_end: float, dt: float, q: np.ndarray = Q0, u: np.ndarray = U0) -> np.ndarray:
    """Rows (t, q, u) by Moreau's midpoint steps with the same law of impact; contacts with a gap <= 0 at the middle."""
    q, u, rows = np.array(q, float), np.array(u, float), []
    rows.append([0.0, *q, *u])
    for step in range(1, round(t_end / dt) + 1):
        middle = q + 0.5 * dt * u
        closed = [i for i in range(3) if gaps(middle)[i] <= 0.0]
        free = u + dt * (INVERSE @ force(middle))
        if closed:
            normal = np.array([-e * v for e, v in zip(RESTITUTION, W_N @ u, strict=True)])
            free, _ = complementarity(free, closed, normal, {})
        u = free
        q = middle + 0.5 * dt * u
        rows.append([step * dt, *q, *u])
    return np.array(rows)


if __name__ == "__main__":
    period, drop, slope, motion = limit_cycle()
    print(f"period {period:.12f} s, drop {1e3 * drop:.10f} mm, multiplier {slope:.6f}")
    for t, q, u, text in motion.log:
        print(f"{t:.12f} {text:18s}", *(f"{x:+.10f}" for x in [*q, *u]))
    rows = moreau(3.0, 2e-5)
    print("Moreau: ", rows[-1])
