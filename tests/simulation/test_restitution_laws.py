"""Laws of restitution and processes of impacts, against oracles that have not seen the engine.

A box without gravity hits a plane with one corner: the laws are those of its Delassus matrix at the corner.
"""

from __future__ import annotations

import ctypes

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers.corner import MASS, SIZE, Corner, rotation
from oracles import impact_laws, super_ball


@pytest.mark.thinned(3)
@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("law", ["poisson", "newton", "energetic"])
@pytest.mark.parametrize("process", ["two-phase", "incremental"])
def test_a_corner_obeys_its_law(seed: int, law: str, process: str) -> None:
    """The velocity after the impact of a corner with friction is that of the oracle, in three dimensions."""
    rng = np.random.default_rng(100 + seed)
    corner = Corner(seed, mu=float(rng.uniform(0.05, 1.2)), e=float(rng.uniform(0.0, 1.0)))
    found = corner.after(restitution_law=law, impact_process=process, limit_energy=False)
    if process == "incremental" or law == "energetic":
        right = impact_laws.incremental(corner.G, corner.gamma, corner.mu, corner.e, law)
    else:
        right = {"poisson": impact_laws.poisson, "newton": impact_laws.newton}[law](
            corner.G, corner.gamma, corner.mu, corner.e
        )
    assert len(corner.run.events) == 1
    # The box turns by some 1e-8 rad before and after.
    np.testing.assert_allclose(found, right.gamma, rtol=0.0, atol=1e-7 * np.linalg.norm(corner.gamma))


@pytest.mark.parametrize("law", ["poisson", "newton"])
@pytest.mark.parametrize(("e", "e_t", "mu"), [(0.8, 0.5, 0.3), (1.0, 1.0, 1e3), (0.6, 0.7, 0.05), (0.9, 0.3, 0.12)])
def test_a_super_ball(law: str, e: float, e_t: float, mu: float) -> None:
    """The first bounces of a ball that grips, or slides, are those in closed form."""
    radius, v, omega = 0.03, np.array([1.0, -0.4, 0.3]), np.array([3.0, 20.0, 5.0])
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", radius)
    scene.set_contact(restitution=e, friction=mu, restitution_law=law, tangential_restitution=e_t)
    q0 = np.array([0.1, 0.2, 0.4, 0.0, 0.0, 0.0, 1.0])
    right = super_ball.hops(q0[:3], v, omega, 2, e, e_t, mu, radius)
    run = cvi.simulate(scene, q0, np.hstack([v, omega]), duration=1.5, dt=0.01)
    assert run.status.ok
    np.testing.assert_allclose(run.events.array("time")[:2], [t for t, _, _ in right], rtol=0.0, atol=1e-10)
    impulses = np.array([event.impulse_vector for event in list(run.events)[:2]])
    np.testing.assert_allclose(impulses, [after.impulse for _, _, after in right], rtol=0.0, atol=1e-9)


def _dropped(height: float, **contact: object) -> cvi.Trajectory:
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", 0.1)
    scene.set_contact(**contact)
    q0 = np.array([0.0, 0.0, 0.1 + height, 0.0, 0.0, 0.0, 1.0])
    return cvi.simulate(scene, q0, duration=1.5, dt=0.01)


def _falls(speed: float) -> float:
    return 0.9 / (1.0 + 0.2 * speed)


def test_restitution_that_falls_with_the_speed() -> None:
    """A table, a function and a compiled function give each bounce its own coefficient."""
    compiled = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(_falls)

    class Compiled:
        address = ctypes.cast(compiled, ctypes.c_void_p).value

        def __call__(self, speed: float) -> float:
            return _falls(speed)

    run = _dropped(1.0, restitution=_falls)
    before, after = run.events.array("gamma_minus"), run.events.array("gamma_plus")
    assert len(run.events) > 3
    np.testing.assert_allclose(after, -before * _falls(-before), rtol=1e-12)
    np.testing.assert_array_equal(run.q, _dropped(1.0, restitution=Compiled()).q)
    table = _dropped(1.0, restitution=[(0.0, 0.8), (2.0, 0.6), (9.0, 0.3)])
    before, after = table.events.array("gamma_minus"), table.events.array("gamma_plus")
    np.testing.assert_allclose(after, -before * np.interp(-before, [0.0, 2.0, 9.0], [0.8, 0.6, 0.3]), rtol=1e-12)


def test_what_does_not_rebound_below_a_speed_stays() -> None:
    """The ball comes to rest after the first bounce that is too slow, without an accumulation of impacts."""
    run = _dropped(1.0, restitution=[(0.0, 0.0), (1.9, 0.0), (2.0, 0.5)])
    assert run.status.ok
    speeds = -run.events.array("gamma_minus")
    assert (speeds[:-1] > 2.0).all()
    assert speeds[-1] < 1.9
    assert run.contact_changes[-1].change == "begin"
    assert abs(run.q[-1, 2] - 0.1) < 1e-9


def _gaining() -> Corner:
    """A corner at which Newton's law makes energy."""
    for seed in range(200):
        corner = Corner(seed, mu=0.9, e=0.95)
        after = impact_laws.newton(corner.G, corner.gamma, corner.mu, corner.e)
        if impact_laws.kinetic_change(corner.G, corner.gamma, after.impulse) > 1e-3:
            return corner
    raise AssertionError("none of these gains energy")


def test_energy_that_newton_would_make_is_told_and_limited() -> None:
    """Without the limit the oracle's gain is in the record, with it none; both say so."""
    corner = _gaining()
    right = impact_laws.newton(corner.G, corner.gamma, corner.mu, corner.e)
    gain = impact_laws.kinetic_change(corner.G, corner.gamma, right.impulse)
    corner.after(restitution_law="newton", limit_energy=False)
    event = corner.run.events[0]
    assert event.loss == pytest.approx(-gain, rel=1e-6)
    assert event.fallback.startswith("gain")
    assert event.restitution == corner.e
    corner.after(restitution_law="newton")
    event = corner.run.events[0]
    assert 0.0 <= event.loss < 1e-6
    assert event.fallback.startswith("gain")
    assert event.restitution < corner.e
    corner.after(restitution_law="energetic")
    assert corner.run.events[0].loss > 0.0
    assert not corner.run.events[0].fallback


LAWS = {
    "newton": {"restitution_law": "newton"},
    "energetic": {"restitution_law": "energetic"},
    "incremental": {"impact_process": "incremental"},
    "tangential": {"tangential_restitution": 0.4},
    "speed": {"restitution": [(0.0, 0.7), (5.0, 0.3)]},
}


@pytest.mark.thinned(3)
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("mu", [0.08, 0.7])
def test_derivatives_of_laws(law: str, mu: float) -> None:
    """Tangents and adjoints of a turning box that hits the ground agree with differences."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", SIZE, mass=MASS)
    scene.set_contact(**{"friction": mu, "restitution": 0.6, **LAWS[law]})
    q0 = np.hstack([[0.0, 0.0, 0.6], pin.Quaternion(rotation(np.random.default_rng(3))).coeffs()])
    v0 = np.array([0.3, -0.2, -0.5, 1.0, -2.0, 0.5])
    found = cvi.check_gradient(scene, q0, v0, duration=0.3, dt=0.01, order=4)
    assert len(found.columns) >= 12 + ("restitution" not in LAWS[law])
    for column in found.columns:
        # Friction that holds has no influence: both columns are rounding.
        assert column.worse.difference <= 1e-7 * column.worse.size + 1e-10, column


def test_laws_are_stored(tmp_path) -> None:
    """A stored run brings its laws; a scene file has the same words."""
    law = {"restitution_law": "newton", "impact_process": "incremental", "tangential_restitution": 0.0}
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", 0.1)
    scene.add_box("box", SIZE)
    scene.set_contact("ball", "ground", restitution=[(0.0, 0.9), (3.0, 0.2)], friction=0.3, **law)
    scene.set_contact("box", limit_energy=False)
    q0 = np.hstack([[0.0, 0.0, 0.4, 0.0, 0.0, 0.0, 1.0], [2.0, 0.0, 0.7, 0.0, 0.0, 0.0, 1.0]])
    assert "restitution law newton, impact process incremental, restitution by the closing speed" in str(scene.report)
    run = cvi.simulate(scene, q0, duration=0.5, dt=0.01)
    run.save(tmp_path / "run.npz")
    again = cvi.simulate(cvi.Trajectory.load(tmp_path / "run.npz").scene, q0, duration=0.5, dt=0.01)
    np.testing.assert_array_equal(run.q, again.q)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"restitution_law": "poison"}, "poisson"),
        ({"impact_process": "routh"}, "incremental"),
        ({"restitution": [(1.0, 0.5), (0.0, 0.5)]}, "ascend"),
        ({"restitution": [(0.0, 1.5)]}, "0, 1"),
        ({"restitution": [0.1, 0.2]}, "table"),
        ({"tangential_restitution": 2.0}, "tangential_restitution"),
    ],
)
def test_what_is_no_law_is_refused(given: dict[str, object], words: str) -> None:
    scene = cvi.Scene()
    with pytest.raises(cvi.InputError, match=words):
        scene.set_contact(**given)


def test_sides_that_disagree_and_laws_that_exclude_each_other() -> None:
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", 0.1)
    scene.set_contact("ball", restitution_law="newton")
    scene.set_contact("ground", restitution_law="energetic")
    with pytest.raises(cvi.SceneError, match="Set it for the pair"):
        scene.gaps(scene.neutral())
    scene.set_contact("ball", "ground", restitution_law="energetic", tangential_restitution=0.5)
    with pytest.raises(cvi.SceneError, match="tangential"):
        scene.gaps(scene.neutral())


def test_functions_that_fail_say_so() -> None:
    def broken(speed: float) -> float:
        return 1.0 / 0.0

    with pytest.raises(cvi.UserFunctionError, match="restitution"):
        _dropped(0.3, restitution=broken)
    with pytest.raises(cvi.ContactviError, match=r"0, 1"):
        _dropped(0.3, restitution=lambda speed: 2.0)
    with pytest.raises(cvi.UserFunctionError, match="ball"):
        _dropped(0.3, restitution=lambda speed: 0.5 if speed == 1.0 else np.nan)
