"""How a contact changes with the configuration: against differences of the engine's own rows, and closed forms.

Differences are central and of fourth order. They are taken with several step sizes; the one that agrees best with its
half is compared, and must agree to 1e-7 itself. Small ones have an error of rounding over step, 1e-15 / 1e-6, and large
ones may reach over to another feature.
"""

from __future__ import annotations

from collections.abc import Callable

import coal
import numpy as np
import pinocchio as pin
import pytest

from contactvi import _core
from contactvi.errors import EngineError
from helpers.engine import scene_of_shapes
from helpers.touching_pairs import (
    EDGE,
    GROUND,
    IDENTITY,
    RIM,
    VERTEX,
    Two,
    Z,
    hull,
    pose,
    random_hull,
    random_pose,
    stacked,
    turn,
)

EXACT = 1e-7  # of differences, relative
STEPS = (1e-3, 2e-4, 4e-5, 8e-6, 1.6e-6, 3.2e-7, 6.4e-8, 1.3e-8)  # [rad; m] down to a hundredth of the radius of edges
NORMAL = np.array([0.6, 0.0, 0.8])
SHAPES: dict[str, Callable[[], coal.CollisionGeometry]] = {
    "sphere": lambda: coal.Sphere(0.05),
    "capsule": lambda: coal.Capsule(0.03, 0.1),
    "box": lambda: coal.Box(0.1, 0.14, 0.08),
    "cylinder": lambda: coal.Cylinder(0.06, 0.2),
    "ellipsoid": lambda: coal.Ellipsoid(0.05, 0.08, 0.06),
    "hull": lambda: hull(random_hull(np.random.default_rng(3), 12)),
    "halfspace": lambda: coal.Halfspace(NORMAL, 0.02),
}
PAIRS = [(a, b) for a in SHAPES for b in SHAPES if (a, b) != ("halfspace", "halfspace")]
GAPS = (0.0, 1e-3, 0.05)  # [m]


# ---- the engine's coordinates and differences in them ----------------------------------------------------------------


def moved(model: pin.Model, q: np.ndarray, w: np.ndarray) -> np.ndarray:
    """q moved along a tangent vector in engine coordinates: those of a free joint are R^3 x SO(3)."""
    found = pin.integrate(model, q, w)
    for k in range(1, model.njoints):
        if model.joints[k].shortname() == "JointModelFreeFlyer":
            i, iv = model.idx_qs[k], model.idx_vs[k]
            found[i : i + 3] = q[i : i + 3] + w[iv : iv + 3]
            R = pin.Quaternion(q[i + 3 : i + 7]).matrix() @ pin.exp3(w[iv + 3 : iv + 6])
            found[i + 3 : i + 7] = pin.Quaternion(R).coeffs()
    return found


def gradient(core, q: np.ndarray, guard: int = 0) -> np.ndarray:
    """The engine's W of a guard in engine coordinates."""
    return np.asarray(core.momentum_to_engine(q, np.asarray(core.gap_gradients(q))[guard]))


def difference(f: Callable[[float], np.ndarray], scale: float = 1.0) -> np.ndarray:
    """df/dh at 0, exact to 1e-7 of the scale as far as the differences themselves tell."""

    def central(h: float) -> np.ndarray:
        return (8.0 * (f(h) - f(-h)) - (f(2.0 * h) - f(-2.0 * h))) / (12.0 * h)

    least, found = np.inf, np.zeros(0)
    for h in STEPS:
        try:
            value = central(0.5 * h)
            own = np.abs(central(h) - value).max()
        except EngineError:  # one of the places lies where features meet
            continue
        if own < least:
            least, found = own, value
        if own < 1e-2 * EXACT * scale:
            break
    assert least <= EXACT * scale, "the differences do not converge"
    return found


def check_columns(model: pin.Model, q: np.ndarray, of: Callable[[np.ndarray], np.ndarray], dW: np.ndarray) -> None:
    """Column k of dW is the derivative of `of` along the k-th tangent vector."""
    scale = max(1.0, np.abs(dW).max())
    for k, unit in enumerate(np.eye(model.nv)):
        column = difference(lambda h, w=unit: of(moved(model, q, h * w)), scale)
        assert np.abs(column - dW[..., k]).max() <= 2.0 * EXACT * scale


def at_gap(gap_at: Callable[[np.ndarray], float], direction: np.ndarray, gap: float) -> np.ndarray:
    """The multiple of a direction at which a gap that grows along it is `gap`."""
    near, far = -1.0, 1.0
    for _ in range(60):
        middle = 0.5 * (near + far)
        near, far = (near, middle) if gap_at(middle * direction) > gap else (middle, far)
    return far * direction


def place_two(two: Two, kinds: tuple[str, str], rng: np.random.Generator, gap: float) -> tuple[pin.SE3, pin.SE3]:
    """Two free bodies turned in any way, at a gap."""
    a, R = random_pose(rng, 0.3), random_pose(rng).rotation
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    if "halfspace" in kinds:
        direction = a.rotation @ NORMAL if kinds[0] == "halfspace" else -R @ NORMAL
        inside = 0.5  # of the way from the halfspace
    else:
        inside = 0.0
    start = a.translation + inside * direction

    def body(x: np.ndarray) -> pin.SE3:
        return pin.SE3(R, start + x)

    if "halfspace" not in kinds:
        near, far = 0.0, 0.6
        for _ in range(60):
            middle = 0.5 * (near + far)
            near, far = (near, middle) if two.gap(a, body(middle * direction)) > gap else (middle, far)
        return a, body(far * direction)
    return a, body((gap - two.gap(a, body(np.zeros(3)))) * direction)


# ---- all pairs of shapes ---------------------------------------------------------------------------------------------


@pytest.mark.thinned(3)
@pytest.mark.parametrize("kinds", PAIRS, ids="-".join)
def test_second_derivative_of_free_bodies(kinds):
    two = Two(SHAPES[kinds[0]](), SHAPES[kinds[1]]())
    rng = np.random.default_rng(5)
    for gap in GAPS:
        a, b = place_two(two, kinds, rng, gap)
        q = two.q(a, b)
        found, W, dW = _core.gap_hessian(two.core, q, 0)
        assert abs(found - two.gap(a, b)) <= 1e-12
        assert np.abs(W - gradient(two.core, q)).max() <= 1e-11
        check_columns(two.model, q, lambda x: np.array([_core.gap_hessian(two.core, x, 0)[0]]), W[None])
        check_columns(two.model, q, lambda x: gradient(two.core, x), dW)


class Arms:
    """Two shapes at the ends of two chains with revolute and spherical joints on one turning base."""

    def __init__(self, a, b):
        rng, self.model, shapes = np.random.default_rng(2), pin.Model(), pin.GeometryModel()

        def place() -> pin.SE3:
            return pin.SE3(pin.exp3(rng.uniform(-1, 1, 3)), rng.uniform(-0.2, 0.2, 3))

        base = self.model.addJoint(0, pin.JointModelRZ(), place(), "base")
        chains = (
            [pin.JointModelRX(), pin.JointModelSpherical(), pin.JointModelRY()],
            [pin.JointModelTranslation(), pin.JointModelRUBY(), pin.JointModelHX(0.1), pin.JointModelSpherical()],
        )
        for name, shape, chain in zip("ab", (a, b), chains, strict=True):
            joint = base
            for k, kind in enumerate(chain):
                joint = self.model.addJoint(joint, kind, place(), f"{name}{k}")
            shapes.addGeometryObject(pin.GeometryObject(name, joint, place(), shape))
        shapes.addCollisionPair(pin.CollisionPair(0, 1))
        self.core = scene_of_shapes(self.model, shapes)
        self.slide = self.model.idx_vs[self.model.getJointId("b0")]

    def placed(self, rng: np.random.Generator, gap: float) -> np.ndarray:
        """Some configuration at a gap, reached by the translation of b along the line between the bodies."""
        q = pin.integrate(self.model, pin.neutral(self.model), rng.uniform(-1, 1, self.model.nv))
        for _ in range(60):
            W, found = gradient(self.core, q), np.asarray(self.core.gaps(q)[0])[0]
            if abs(found - gap) < 1e-9:
                break
            w = np.zeros(self.model.nv)
            w[self.slide : self.slide + 3] = (gap - found) * W[self.slide : self.slide + 3]
            q = pin.integrate(self.model, q, w)
        return q


@pytest.mark.parametrize("kinds", PAIRS, ids="-".join)
def test_second_derivative_on_arms(kinds):
    arms = Arms(SHAPES[kinds[0]](), SHAPES[kinds[1]]())
    rng = np.random.default_rng(3)
    for gap in (1e-6, 0.02):
        q = arms.placed(rng, gap)
        dW = _core.gap_hessian(arms.core, q, 0)[2]
        check_columns(arms.model, q, lambda x: gradient(arms.core, x), dW)


def test_bodies_of_one_joint_keep_their_gap():
    """Both shapes on one body: the contact moves with it, and the gap has no derivative."""
    model, shapes = pin.Model(), pin.GeometryModel()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), IDENTITY, "body")
    for name, x in (("a", 0.0), ("b", 0.2)):
        shapes.addGeometryObject(pin.GeometryObject(name, joint, pose(x, 0.1 * x), coal.Sphere(0.05)))
    shapes.addCollisionPair(pin.CollisionPair(0, 1))
    core = scene_of_shapes(model, shapes)
    _, W, dW = _core.gap_hessian(core, pin.randomConfiguration(model, -np.ones(7), np.ones(7)), 0)
    assert np.abs(W).max() <= 1e-15
    assert np.abs(dW).max() <= 1e-14


# ---- the tangential rows, the normal and the points ------------------------------------------------------------------


def carried(t: np.ndarray, n0: np.ndarray, n1: np.ndarray) -> np.ndarray:
    """The tangent t turned with its normal from n0 to n1 by the shortest turn."""
    return t - t @ n1 / (1.0 + n0 @ n1) * (n0 + n1)


@pytest.mark.thinned(3)
@pytest.mark.parametrize("kinds", PAIRS, ids="-".join)
def test_rows_normal_and_points(kinds):
    two = Two(SHAPES[kinds[0]](), SHAPES[kinds[1]]())
    rng = np.random.default_rng(6)
    q = two.q(*place_two(two, kinds, rng, 1e-3))

    def normal(x: np.ndarray) -> np.ndarray:
        return _core.gap_hessian(two.core, x, 0)[1][6:9]  # the engine's velocity of b is that of its origin

    n = normal(q)
    t1 = np.cross(n, rng.normal(size=3))
    t1 /= np.linalg.norm(t1)
    W, dW, places = _core.contact_row_changes(two.core, q, 0, t1)
    assert np.abs(W[6:9] - np.array([n, t1, np.cross(n, t1)]).T).max() <= 1e-14

    def rows(x: np.ndarray) -> np.ndarray:
        return np.asarray(_core.contact_row_changes(two.core, x, 0, carried(t1, n, normal(x)))[0]).T

    check_columns(two.model, q, rows, np.array(dW))
    check_columns(two.model, q, normal, places[:3])
    check_columns(two.model, q, lambda x: np.concatenate([p[0] for p in two.core.gaps(x)[2:]]), places[3:])


# ---- closed forms ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gap", [0.0, 0.3])
def test_two_balls(gap):
    """The distance of two centres, d = |x|: the second derivative is (1 - n n^T) / d in x = x_b - x_a."""
    two = Two(coal.Sphere(0.1), coal.Sphere(0.2))
    n = np.array([2.0, -1.0, 2.0]) / 3.0
    d = 0.3 + gap
    found, W, dW = _core.gap_hessian(
        two.core, two.q(pose(0.1, 0.2, 0.3), pose(*(np.array([0.1, 0.2, 0.3]) + d * n))), 0
    )
    assert abs(found - gap) <= 1e-15
    zero, P = np.zeros((3, 3)), (np.eye(3) - np.outer(n, n)) / d
    assert np.abs(W - np.concatenate([-n, np.zeros(3), n, np.zeros(3)])).max() <= 1e-15
    assert np.abs(dW - np.block([[P, zero, -P, zero], [zero] * 4, [-P, zero, P, zero], [zero] * 4])).max() <= 1e-14


@pytest.mark.parametrize("gap", [0.0, 0.2])
def test_ellipsoid_over_a_halfspace(gap):
    """gap = z - |D R^T e_z|; turned by w in its body, k = R^T e_z becomes k + k x w."""
    D = np.array([0.1, 0.2, 0.15])
    two = Two(GROUND, coal.Ellipsoid(*D))
    R = turn([1.0, 2.0, 0.5], 0.7)
    k = R.T @ Z
    s = np.linalg.norm(D * k)
    _, _, dW = _core.gap_hessian(two.core, two.q(IDENTITY, pose(0.3, 0.1, s + gap, R)), 0)
    # f(k) = -|D k|: the second derivative along w is that of W_w = f'(k) (k x e_w), with k moved by k x w.
    first = -(D**2) * k / s
    second = -(np.diag(D**2) / s - np.outer(D**2 * k, D**2 * k) / s**3)
    K = pin.skew(k)
    expected = K.T @ second @ K
    for j in range(3):
        dk = np.cross(k, np.eye(3)[j])
        expected[:, j] += [first @ np.cross(dk, np.eye(3)[i]) for i in range(3)]
    assert np.abs(dW[9:, 9:] - expected).max() <= 1e-14
    assert np.abs(dW[6:9, 6:]).max() <= 1e-15


# ---- contact points with features of their own -----------------------------------------------------------------------


def leaning(angle: float) -> np.ndarray:
    return turn([1.0, 0.3, 0.0], angle)


LYING = turn([1.0, 0.0, 0.0], np.pi / 2)
# name -> shapes, poses and the kind of at least one of the points
POINTS = {
    "box flat on the ground": (lambda: GROUND, lambda: coal.Box(0.2, 0.3, 0.2), pose(0.1, 0, 0.1), VERTEX),
    "ground under a hull": (lambda: coal.Box(0.2, 0.3, 0.2), lambda: GROUND, pose(0.1, 0, -0.1), VERTEX),
    "capsule lying": (lambda: GROUND, lambda: coal.Capsule(0.05, 0.3), pose(0, 0, 0.05, LYING), VERTEX),
    "box on a box": (lambda: coal.Box(0.2, 0.2, 0.2), lambda: coal.Box(0.1, 0.1, 0.2), stacked(0.3), VERTEX),
    "box under a box": (lambda: coal.Box(0.1, 0.1, 0.2), lambda: coal.Box(0.2, 0.2, 0.2), stacked(0.3), VERTEX),
    "crossed boxes": (lambda: coal.Box(0.2, 0.2, 0.2), lambda: coal.Box(0.2, 0.2, 0.2), stacked(0.6), EDGE),
    "cylinder standing": (lambda: GROUND, lambda: coal.Cylinder(0.1, 0.2), pose(0, 0, 0.1), VERTEX),
    "cylinder lying on a box": (
        lambda: coal.Box(0.2, 0.2, 0.2),
        lambda: coal.Cylinder(0.05, 0.3),
        pose(0, 0, 0.15, LYING),
        EDGE,
    ),
}


def check_features(two: Two, q: np.ndarray, features: list[int]) -> None:
    for feature in features:
        found, W, dW = _core.gap_hessian(two.core, q, 0, feature)
        assert abs(found) <= 1e-3
        check_columns(two.model, q, lambda x, f=feature: np.array([_core.gap_hessian(two.core, x, 0, f)[0]]), W[None])
        check_columns(two.model, q, lambda x, f=feature: _core.gap_hessian(two.core, x, 0, f)[1], dW)


@pytest.mark.parametrize("name", POINTS)
def test_contact_points(name):
    make_a, make_b, at, kind = POINTS[name]
    two = Two(make_a(), make_b())
    world = random_pose(np.random.default_rng(1))
    a, b = world, world * at
    points = two.points(a, b, 1e-6, 8)
    assert kind in points["kind"]
    assert 0 not in points["feature"]
    check_features(two, two.q(a, b), points["feature"])


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("under", ["halfspace", "box"])
def test_a_rolling_rim(under, swapped):
    plane = GROUND if under == "halfspace" else coal.Box(1.0, 1.0, 0.2)
    cylinder = coal.Cylinder(0.1, 0.3)
    two = Two(cylinder, plane) if swapped else Two(plane, cylinder)
    world, up = random_pose(np.random.default_rng(2)), 0.0 if under == "halfspace" else 0.1
    body = world * pose(0.05, 0.1, up + 0.15 * np.cos(0.3) + 0.1 * np.sin(0.3), turn([1, 0, 0], 0.3))
    a, b = (body, world) if swapped else (world, body)
    b = two.touching(a, b)
    points = two.points(a, b, 1e-6)
    assert RIM in points["kind"]
    check_features(two, two.q(a, b), points["feature"])


# ---- limits of joints ------------------------------------------------------------------------------------------------


def test_a_joint_limit_has_no_curvature():
    model, shapes = pin.Model(), pin.GeometryModel()
    model.addJoint(0, pin.JointModelRX(), IDENTITY, "j", np.ones(1), np.ones(1), np.array([-1.0]), np.array([1.0]))
    core = scene_of_shapes(model, shapes, limits=1.0)
    for guard, sign in ((0, 1.0), (1, -1.0)):
        gap, W, dW = _core.gap_hessian(core, np.array([0.25]), guard)
        assert gap == 1.0 + sign * 0.25
        assert gradient(core, np.array([0.25]), guard) == W
        assert sign == W
        assert dW[0, 0] == 0.0
    with pytest.raises(EngineError, match="a joint limit has no features"):
        _core.gap_hessian(core, np.array([0.25]), 0, 1)


# ---- where there is no derivative ------------------------------------------------------------------------------------

CAPSULE = (0.05, 0.2)
CUBE = (0.2, 0.2, 0.2)
TILTED = turn([1, 0, 0], np.pi / 4)
REFUSED = {
    "balls with one centre": (coal.Sphere(0.1), coal.Sphere(0.2), pose(), "ball against ball"),
    "box flat on the ground": (GROUND, coal.Box(*CUBE), pose(0, 0, 0.1), "a vertex and an edge"),
    "edge along the ground": (GROUND, coal.Box(*CUBE), pose(0, 0, 0.1 * 2**0.5, TILTED), "a vertex and an edge"),
    "cylinder standing": (GROUND, coal.Cylinder(0.1, 0.2), pose(0, 0, 0.1), "the end of a cylinder and its rim"),
    "cylinder lying": (GROUND, coal.Cylinder(0.1, 0.2), pose(0, 0, 0.1, LYING), "the side of a cylinder and a rim"),
    "capsule lying": (GROUND, coal.Capsule(*CAPSULE), pose(0, 0, 0.05, LYING), "the end and the side of a capsule"),
    "boxes face on face": (coal.Box(*CUBE), coal.Box(0.1, 0.1, 0.2), stacked(0.3), "a vertex and an edge"),
    "capsule on a box": (coal.Box(*CUBE), coal.Capsule(*CAPSULE), pose(0, 0, 0.15, LYING), "shape lies between"),
    "cylinder on a box": (coal.Box(*CUBE), coal.Cylinder(0.05, 0.1), pose(0, 0, 0.15, LYING), "shape lies between"),
    "edge on a box": (coal.Box(*CUBE), coal.Box(*CUBE), pose(0, 0, 0.1 + 0.1 * 2**0.5, TILTED), "shape lies between"),
    "capsules side by side": (coal.Capsule(*CAPSULE), coal.Capsule(*CAPSULE), pose(0.1), "nearest point"),
    "a short capsule beside": (coal.Capsule(*CAPSULE), coal.Capsule(0.05, 0.05), pose(0.1), "nearest point"),
    "ball over a border": (coal.Box(*CUBE), coal.Sphere(0.1), pose(0.1, 0, 0.2), "an edge and a face"),
    "ball over a corner": (coal.Box(*CUBE), coal.Sphere(0.1), pose(0.1, 0.1, 0.2), "a vertex and an edge"),
    "ball where a capsule ends": (coal.Capsule(*CAPSULE), coal.Sphere(0.1), pose(0.15, 0, 0.1), "the end and the side"),
    "ball over a disc": (coal.Cylinder(0.1, 0.2), coal.Sphere(0.1), pose(0.1, 0, 0.2), "of a cylinder and its rim"),
    "ball beside a rim": (coal.Cylinder(0.1, 0.2), coal.Sphere(0.1), pose(0.2, 0, 0.1), "of a cylinder and a rim"),
    "capsule over a border": (coal.Box(*CUBE), coal.Capsule(*CAPSULE), pose(0.1, 0, 0.25), "an edge and a face"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_where_the_nearest_point_is_not_unique(name):
    a, b, at, reason = REFUSED[name]
    two = Two(a, b)
    with pytest.raises(EngineError, match="The gap has no second derivative there") as refusal:
        _core.gap_hessian(two.core, two.q(IDENTITY, at), 0)
    assert reason in str(refusal.value)


@pytest.mark.parametrize("angle", [0.0, 1e-12])
def test_parallel_edges_are_refused(angle):
    """The crossing of two edges, taken as one where they are parallel."""
    two = Two(coal.Box(0.2, 0.2, 0.2), coal.Box(0.2, 0.2, 0.2))
    crossed = stacked(0.6)
    feature = next(
        f
        for f, kind in zip(*(two.points(IDENTITY, crossed)[k] for k in ("feature", "kind")), strict=True)
        if kind == EDGE
    )
    refused = []
    for k in range(12):
        try:
            _core.gap_hessian(two.core, two.q(IDENTITY, stacked(angle)), 0, (feature >> 20 << 20) | k)
        except EngineError as error:
            refused.append(str(error))
    assert len(refused) == 4, "four edges of a box are parallel to one"
    assert all("the nearest points are not unique: edge against edge" in text for text in refused)


def test_a_flat_rim_is_refused():
    two = Two(GROUND, coal.Cylinder(0.1, 0.2))
    tilted = pose(0, 0, 0.1 * np.cos(0.1) + 0.1 * np.sin(0.1), turn([1, 0, 0], 0.1))
    (feature,) = two.points(IDENTITY, tilted, 1e-6)["feature"]
    with pytest.raises(EngineError, match="a rim flat on a face"):
        _core.gap_hessian(two.core, two.q(IDENTITY, pose(0, 0, 0.1)), 0, feature)
