"""Derivatives of what rests, and of what is pushed: kinks that were taken."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from derivatives.differences import FOURTH, transpose_error


def table(e: float = 0.0) -> tuple[cvi.Scene, np.ndarray, np.ndarray]:
    """Return a box that rests on a plane, and a ball that slides towards it."""
    scene = cvi.Scene()
    scene.add_halfspace(name="ground")
    scene.add_box("box", [0.2, 0.2, 0.1], mass=1.0)
    scene.add_sphere("ball", 0.04, mass=0.5)
    scene.set_contact("ground", "box", friction=0.3, restitution=0.0)
    scene.set_contact("ball", "box", friction=0.3, restitution=e)
    scene.set_contact("ball", "ground", friction=0.0, restitution=0.0)
    q, v = pin.neutral(scene.model), np.zeros(12)
    q[2], q[7], q[9], v[6] = 0.05, -0.3, 0.04, 1.03
    return scene, q, v


def by_force(scene: cvi.Scene, q: np.ndarray, v: np.ndarray, k: int, **options: Any) -> np.ndarray:
    """Return the derivative of the end by a constant generalized force, by differences."""
    found, step, steps = np.zeros(2 * scene.nv), 1e-3, round(options["duration"] / options["dt"])
    base = cvi.simulate(scene, q, v, **options)
    for count, weight in FOURTH:
        control = np.tile(count * step * np.eye(scene.nv)[k], (steps, 1))
        run = cvi.simulate(scene, q, v, control=control, **options)
        end = np.r_[pin.difference(scene.model, base.q[-1], run.q[-1]), run.v[-1] - base.v[-1]]
        found += weight / step * end
    return found


@pytest.mark.parametrize("order", [2, 4, 8])
def test_a_box_that_rests_stays_where_forces_are_small(order: int) -> None:
    """No force within friction and weight moves it, and its derivative says so."""
    scene, q, v = table()
    options = {"duration": 0.1, "dt": 0.01, "order": order}
    S = cvi.simulate(scene, q, v, record="gradient", **options).sensitivity("control")
    assert np.abs(S.matrix[-1][[*range(6), *range(12, 18)]][:, :6]).max() < 1e-12
    for k in (6, 8):
        np.testing.assert_allclose(S.matrix[-1][:, k], by_force(scene, q, v, k, **options), atol=1e-9)


@pytest.mark.parametrize("order", [2, 4])
def test_pushing_begins(order: int) -> None:
    """What the ball's force does is smooth; along forces on the box itself the impact has a kink, which is named."""
    scene, q, v = table()
    options = {"duration": 0.25, "dt": 0.01, "order": order}
    run = cvi.simulate(scene, q, v, record="gradient", **options)
    assert len(run.events) > 0
    S = run.sensitivity("control", on_kink="taken")
    np.testing.assert_allclose(S.matrix[-1][:, 6], by_force(scene, q, v, 6, **options), rtol=1e-6, atol=1e-8)
    assert any(kink.reason in ("simultaneous", "redundant", "witness") for kink in S.report.kinks)
    assert "kink" in str(S.report)
    with pytest.raises(cvi.NotDifferentiable):
        run.sensitivity("control")
    alone = run.sensitivity("control:ball", on_kink="taken")
    np.testing.assert_array_equal(alone.matrix, S.matrix[:, :, 6:12])
    with pytest.raises(cvi.InputError, match="control:"):
        run.sensitivity("control:bowl")


def test_forces_of_one_joint_are_checked_as_such() -> None:
    """Differences of the forces of a ball are those of its own columns."""
    scene, q, v = table()
    found = cvi.check_gradient(scene, q, v, 0.1, 0.01, order=4, wrt=["control:ball"])
    assert found.ok
    assert [column.name.split()[1][:4] for column in found.columns] == ["ball"] * 6


def test_without_a_kink_nothing_is_noted() -> None:
    scene, q, v = table()
    run = cvi.simulate(scene, q, v, duration=0.1, dt=0.01, order=4, record="gradient")
    assert run.sensitivity("control", on_kink="taken").report.kinks == ()
    assert transpose_error(run, ["v0", "control"]) <= 2e-12


def taken_transpose_error(run: cvi.Trajectory, S: cvi.Sensitivity) -> float:
    """Return the largest difference of the adjoint from the tangent at the kinks that were taken, relative."""
    rng = np.random.default_rng(0)
    lq, lv = rng.standard_normal((2, len(run.t), run.scene.nv))
    found = cvi.gradient(run, (lq, lv), S.names, on_kink="taken")[1]
    got = np.concatenate([np.atleast_2d(found[name]).sum(axis=0) for name in S.names])
    expected = np.einsum("ni,nik->k", np.hstack([lq, lv]), S.matrix)
    return float(np.abs(got - expected).max() / np.abs(expected).max())


@pytest.mark.parametrize(
    ("order", "e", "y", "kink"), [(2, 0.0, 0.03, False), (4, 0.5, 0.08, True), (2, 0.5, 0.08, True)]
)
def test_a_pushed_box_comes_to_rest_on_four_corners_at_once(order: int, e: float, y: float, kink: bool) -> None:
    """The box turns while it slides, and its corners come to rest within 1e-6 of a step: the run takes one order.

    Where that is no kink, differences to both sides agree but for curvature.
    """
    scene, q, v = table(e)
    q[8] = y
    options = {"duration": 0.4, "dt": 0.01, "order": order}
    run = cvi.simulate(scene, q, v, record="gradient", **options)
    with pytest.raises(cvi.NotDifferentiable):
        run.sensitivity(["q0", "v0"])
    S = run.sensitivity(["q0", "v0"], on_kink="taken")
    assert any(met.reason in ("stick", "friction") for met in S.report.kinks) == kink
    assert taken_transpose_error(run, S) < 1e-10
    # Where the ball starts across its way, and how fast it comes: both keep the branch. The corners share the weight,
    # and their shares change by those of least norm, the run's by others: the friction of corners that slide along
    # nearly equal directions differs by some 1e-5 of what changes.
    middle = np.r_[run.q[-1, :2], run.v[-1, :2]]

    def differences(k: int, step: float) -> tuple[np.ndarray, np.ndarray]:
        """Return those to both sides."""
        d = step * np.eye(24)[k]
        ends = [
            cvi.simulate(scene, pin.integrate(scene.model, q, s * d[:12]), v + s * d[12:], **options) for s in (1, -1)
        ]
        box = [np.r_[end.q[-1, :2], end.v[-1, :2]] for end in ends]
        return (box[0] - middle) / step, (middle - box[1]) / step

    for k in (7, 18):
        one, other = differences(k, 1e-5)
        exact = S.matrix[-1][[0, 1, 12, 13], k]
        turned = pin.log3(pin.Quaternion(run.q[-1, 3:7]).matrix())
        exact[:2] = pin.exp3(turned)[:2, :2] @ exact[:2]
        np.testing.assert_allclose(exact, 0.5 * (one + other), rtol=0.0, atol=1e-5)
        if not kink:  # the sides differ by curvature, in proportion to the step
            near, near_other = differences(k, 5e-6)
            np.testing.assert_allclose((one - other)[:2], 2.0 * (near - near_other)[:2], rtol=2e-2, atol=1e-10)
