"""Which geoms of an MJCF may touch, with what friction: MuJoCo's rules (its documentation, Computation, Collision)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from contactvi.importing.mjcf.compiler import Source

_SLIDING, _TORSIONAL, _ROLLING = 1, 4, 6  # contact dimensions: without friction, with torsional and rolling friction


@dataclass(frozen=True)
class GeomPair:
    """Two geoms that may touch.

    Attributes:
        friction: sliding friction, the smaller of two directions.
        damping_ratio: of MuJoCo's soft contact, for which `restitution` gives the ratio of speeds.
        turning: radii of the friction against spinning and rolling [m].
        untaken: what is lost of a contact whose radii are not taken, empty: nothing.
        adhesion: pull up to which the geoms stay together [N]; MuJoCo's is that of each contact point.
    """

    a: int
    b: int
    friction: float
    damping_ratio: float
    turning: tuple[float, float]
    untaken: str
    adhesion: float = 0.0


def geom_pairs(source: Source) -> list[GeomPair]:
    """Return the pairs that MuJoCo tests, and note what of their contacts the engine does not have."""
    if source.off("CONTACT") or source.off("CONSTRAINT"):
        if source.m.ngeom:
            source.report.note("used", "option", "contact", "switched off by the file: nothing in it touches")
        return []
    return [*_listed(source), *_mixed(source)]


def restitution(damping_ratio: float) -> float:
    """Return the ratio of the speeds after and before a collision with a spring and damper that never pulls."""
    zeta = damping_ratio
    if zeta <= 0.0:
        return 1.0
    if abs(zeta - 1.0) < 1e-9:
        return float(np.exp(-2.0))
    w = float(np.sqrt(abs(1.0 - zeta**2)))
    if zeta < 1.0:
        return float(np.exp(-zeta / w * (np.pi - np.arctan2(2.0 * zeta * w, 1.0 - 2.0 * zeta**2))))
    return float(np.exp(-zeta / w * np.log((zeta + w) / (zeta - w))))


def geom_friction(source: Source, geom: int) -> float:
    """Return the sliding friction of one geom, for contacts with what is not in the file."""
    return float(source.m.geom_friction[geom][0]) if source.m.geom_condim[geom] > _SLIDING else 0.0


def geom_turning(source: Source, geom: int) -> tuple[float, float]:
    """Return the radii of friction against spinning and rolling [m] of one geom, as geom_friction."""
    sliding, torsional, rolling = (float(x) for x in source.m.geom_friction[geom])
    return _turning(sliding, torsional, rolling, int(source.m.geom_condim[geom]))


def _turning(sliding: float, torsional: float, rolling: float, dim: int) -> tuple[float, float]:
    """Return the radii of spinning and rolling friction [m]: a pure spin meets the torque torsional * N."""
    if not sliding > 0.0:
        return 0.0, 0.0
    return torsional / sliding if dim >= _TORSIONAL else 0.0, rolling if dim >= _ROLLING else 0.0


def _listed(source: Source) -> Iterator[GeomPair]:
    """Yield the <pair>s of the file, each once."""
    m = source.m
    seen: set[tuple[int, int]] = set()
    for p in range(m.npair):
        a, b = sorted((int(m.pair_geom1[p]), int(m.pair_geom2[p])))
        if (a, b) in seen:
            source.lose("pair", pair_title(source, a, b), "given twice: the first one counts")
            continue
        seen.add((a, b))
        gap = float(m.pair_margin[p]) + float(m.pair_gap[p])
        pull = float(m.pair_adhesion[p]) if hasattr(m, "pair_adhesion") else 0.0
        yield _pair(source, a, b, np.array(m.pair_friction[p]), int(m.pair_dim[p]), m.pair_solref[p], gap, pull)


def _mixed(source: Source) -> Iterator[GeomPair]:
    """Yield the pairs that contype and conaffinity let touch."""
    m = source.m
    for a, b in np.argwhere(_candidates(source)).tolist():
        if m.geom_priority[a] != m.geom_priority[b]:
            first = a if m.geom_priority[a] > m.geom_priority[b] else b
            friction, dim, solref = m.geom_friction[first], int(m.geom_condim[first]), m.geom_solref[first]
        else:
            friction = np.maximum(m.geom_friction[a], m.geom_friction[b])
            dim = int(max(m.geom_condim[a], m.geom_condim[b]))
            solref = _mixed_solref(source, a, b)
        five = np.array([friction[0], friction[0], friction[1], friction[2], friction[2]])
        gap = float(m.geom_margin[a] + m.geom_margin[b] + m.geom_gap[a] + m.geom_gap[b])
        pull = float(m.geom_adhesion[a] + m.geom_adhesion[b]) if hasattr(m, "geom_adhesion") else 0.0
        yield _pair(source, a, b, five, dim, solref, gap, pull)


def _candidates(source: Source) -> np.ndarray:
    """Return the mask (ngeom, ngeom), above the diagonal, of what may touch by the bits, bodies and exclusions."""
    m = source.m
    types, affinities = np.asarray(m.geom_contype), np.asarray(m.geom_conaffinity)
    bits = types[:, None] & affinities[None, :]
    mask = np.triu((bits | bits.T) != 0, 1)
    body = np.asarray(m.geom_bodyid)
    weld = np.asarray(m.body_weldid)[body]
    mask &= weld[:, None] != weld[None, :]
    if not source.off("FILTERPARENT"):
        above = np.asarray(m.body_weldid)[np.asarray(m.body_parentid)[weld]]
        related = (weld[:, None] == above[None, :]) | (weld[None, :] == above[:, None])
        mask &= ~(related & (weld[:, None] != 0) & (weld[None, :] != 0))
    flat = np.isin(np.asarray(m.geom_type), [source.number("Geom", "PLANE"), source.number("Geom", "HFIELD")])
    mask &= ~(flat[:, None] & flat[None, :])
    for signature in np.asarray(m.exclude_signature).tolist():
        i, j = signature >> 16, signature & 0xFFFF
        mask &= ~((body[:, None] == i) & (body[None, :] == j)) & ~((body[:, None] == j) & (body[None, :] == i))
    for p in range(m.npair):
        a, b = sorted((int(m.pair_geom1[p]), int(m.pair_geom2[p])))
        mask[a, b] = False
    return np.asarray(mask)


def _mixed_solref(source: Source, a: int, b: int) -> np.ndarray:
    m = source.m
    one, two = np.array(m.geom_solref[a]), np.array(m.geom_solref[b])
    x, y = float(m.geom_solmix[a]), float(m.geom_solmix[b])
    share = x / (x + y) if x + y > 0.0 else 0.5
    mixed = share * one + (1.0 - share) * two if one[0] > 0.0 and two[0] > 0.0 else np.minimum(one, two)
    return np.asarray(mixed)


def _pair(
    source: Source, a: int, b: int, friction: np.ndarray, dim: int, solref: np.ndarray, gap: float, pull: float
) -> GeomPair:
    """Return a pair; friction: two sliding, one torsional, two rolling coefficients."""
    title = pair_title(source, a, b)
    sliding = float(min(friction[:2])) if dim > _SLIDING else 0.0
    lost = dim >= _TORSIONAL and np.any(friction[2 : 3 if dim < _ROLLING else 5])
    untaken = f"torsional{' and rolling' if dim >= _ROLLING else ''} friction (condim {dim})" if lost else ""
    if dim > _SLIDING and friction[0] != friction[1]:
        source.report.note("changed", "pair", title, "friction differs in two directions: the smaller one counts")
    if gap:
        source.lose("pair", title, "margin or gap: shapes meet where they touch")
    if pull:
        text = f"adhesion {pull:g} N of the pair, which its contact points share (MuJoCo's is that of each point)"
        source.report.note("changed", "pair", title, text)
    turning = _turning(sliding, float(friction[2]), float(min(friction[3:])), dim)
    return GeomPair(a, b, sliding, _damping_ratio(solref), turning, untaken, pull)


def surface_velocity(source: Source, geom: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the linear and angular velocity of the surface of a geom; None: it has none (or MuJoCo is before 3.11)."""
    field = getattr(source.m, "geom_surfacevel", None)
    if field is None or not np.any(field[geom]):
        return None
    return np.array(field[geom][:3]), np.array(field[geom][3:])


def _damping_ratio(solref: np.ndarray) -> float:
    """Return the damping ratio of solref: (time constant, ratio), or (-stiffness, -damping)."""
    a, b = float(solref[0]), float(solref[1])
    if a > 0.0:
        return b
    return -b / (2.0 * float(np.sqrt(-a))) if a < 0.0 else 1.0


def pair_title(source: Source, a: int, b: int) -> str:
    return f"{source.names['geom'][a]} | {source.names['geom'][b]}"
