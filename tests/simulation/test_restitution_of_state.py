"""Restitution as a function of the closing speed, the slip before the impact and the time."""

from __future__ import annotations

import ctypes

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi

RADIUS, MASS, G = 0.05, 0.4, 9.81


def coefficient(closing, slip, t):
    return 0.9 / (1.0 + 0.1 * closing) / (1.0 + 0.2 * slip) * (0.8 + 0.2 * np.cos(t))


def thrown(law=coefficient, **contact) -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_halfspace(name="ground")
    scene.add_sphere("ball", RADIUS, MASS, placement=(0.0, 0.0, RADIUS + 0.2))
    scene.set_contact("ball", "ground", friction=0.1, restitution_of_state=law, **contact)
    return scene


def speeds(scene: cvi.Scene) -> np.ndarray:
    return scene.velocity({"ball": ((1.5, 0.4, 0.0), (0.0, 0.0, 0.0))})


@pytest.mark.parametrize("law", ["poisson", "newton"])
def test_the_first_impacts(law):
    """A ball: the normal impulse is apart from friction, so that gamma+ = -e gamma- whatever the slip is."""
    scene = thrown(restitution_law=law)
    traj = cvi.simulate(scene, None, 3.0 * speeds(scene), 0.8, dt=0.01, order=4)
    assert len(traj.events) >= 2
    closing, slip, t = np.sqrt(2.0 * G * 0.2), 3.0 * np.hypot(1.5, 0.4), np.sqrt(0.4 / G)
    for event in list(traj.events)[:2]:
        e = coefficient(closing, slip, t)
        assert event.gamma_minus == pytest.approx(-closing, rel=1e-9)
        assert event.gamma_plus == pytest.approx(e * closing, rel=1e-9)
        # Friction takes mu (1 + e) closing of the speed, and 5/2 times as much by the spin.
        slip -= 0.1 * (1.0 + e) * closing * 3.5
        t += 2.0 * e * closing / G
        closing *= e
        assert slip > 0.0


def test_in_a_dense_step():
    """The coefficient is that of the speeds at the start of the step, an order 1 of its length away."""
    for dt in (2e-3, 1e-3):
        scene = thrown()
        traj = cvi.simulate(scene, None, speeds(scene), 0.3, dt=dt, contact_mode="steps")
        e = coefficient(np.sqrt(2.0 * G * 0.2), np.hypot(1.5, 0.4), np.sqrt(0.4 / G))
        left = np.sqrt(2.0 * G * 0.2) * e - G * (0.3 - np.sqrt(0.4 / G))
        up = pin.Quaternion(traj.q[-1, 3:7]).matrix()[2]  # in the axes of the ball, which friction has turned
        # The impact may be a step early or late: so much later it falls, and by e of so much its speed is another one.
        assert abs(up @ traj.v[-1, :3] - left) <= (1.0 + e) * G * dt


def slopes(closing, slip, t):
    """The derivatives of coefficient()."""
    e = coefficient(closing, slip, t)
    by_time = -0.2 * np.sin(t) / (0.8 + 0.2 * np.cos(t))
    return -0.1 * e / (1.0 + 0.1 * closing), -0.2 * e / (1.0 + 0.2 * slip), e * by_time


class Compiled:
    """A function of Python that is one of C, as numba.cfunc makes them."""

    def __init__(self):
        double = ctypes.c_double

        def law(closing, slip, t, values):
            values[0] = coefficient(closing, slip, t)
            values[1], values[2], values[3] = slopes(closing, slip, t)

        self._kept = ctypes.CFUNCTYPE(None, double, double, double, ctypes.POINTER(double))(law)
        self.address = ctypes.cast(self._kept, ctypes.c_void_p).value


def test_a_compiled_function():
    runs = []
    for law in (coefficient, Compiled()):
        scene = thrown(law)
        runs.append(cvi.simulate(scene, None, speeds(scene), 0.6, dt=0.01, order=2).q)
    assert np.array_equal(*runs)


@pytest.mark.parametrize("law", [coefficient, (coefficient, slopes), Compiled()], ids=["plain", "given", "compiled"])
@pytest.mark.parametrize("order", [2, 4])
def test_derivatives_are_those_of_differences(order, law):
    scene = thrown(law)
    q, v = scene.neutral(), speeds(scene)
    weights, none = np.linspace(0.5, 1.5, 6), np.zeros(6)

    def run(dq, dv, **options):
        start = pin.integrate(scene.model, q, dq)
        return cvi.simulate(scene, start, v + dv, 0.4, dt=5e-3, order=order, solver_tol=1e-14, **options)

    traj = run(none, none, record="gradient")
    assert len(traj.events) == 1
    _, found = cvi.gradient(traj, (none, weights))
    step = 1e-5
    for key, place in (("q0", 0), ("v0", 1)):
        for k in range(6):
            direction = step * np.eye(6)[k]
            ends = [run(*((none,) * place), s * direction, *((none,) * (1 - place))).v[-1] for s in (1, -1, 2, -2)]
            change = 8.0 * (ends[0] - ends[1]) - (ends[2] - ends[3])
            assert found[key][k] == pytest.approx(weights @ change / (12.0 * step), abs=1e-6)


def test_a_later_setting_replaces_it():
    scene = thrown()
    scene.set_contact("ball", "ground", restitution=0.25)
    traj = cvi.simulate(scene, None, speeds(scene), 0.3, dt=0.01)
    assert traj.events[0].gamma_plus == pytest.approx(-0.25 * traj.events[0].gamma_minus, rel=1e-9)


def test_what_is_refused():
    with pytest.raises(cvi.InputError, match="twice"):
        thrown(restitution=0.5)
    with pytest.raises(cvi.InputError, match="no function"):
        thrown(0.5)
    scene = thrown()
    scene.set_contact("ball", "ground", friction=0.0)
    with pytest.raises(cvi.SceneError, match="friction 0"):
        scene.built()
    with pytest.raises(cvi.UserFunctionError, match="outside of its range"):
        thrown(lambda closing, slip, t: 0.5 + 0.4 * closing)
    with pytest.raises(cvi.InputError, match="derivatives of the law of restitution are not its own"):
        thrown((coefficient, lambda closing, slip, t: (0.0 * t, 0.0 * t, 0.0 * t)))
    with pytest.raises(cvi.UserFunctionError, match="failed"):
        thrown(lambda closing, slip, t: 0.5 if slip > 0.1 else 0.6)  # not of arrays
    # Where it was tried it is one; beyond it ends the run, wherever the steps are.
    for options in ({}, {"contact_mode": "steps"}):
        later = thrown(lambda closing, slip, t: np.where(t > 0.31, 1.5, 0.5))
        with pytest.raises(cvi.UserFunctionError, match="outside of its range"):
            cvi.simulate(later, None, speeds(later), 0.5, dt=0.002, **options)


def test_no_nonsense_is_asked():
    """All that the function is given is finite, and speeds are not negative."""
    asked = []

    def law(*numbers):
        asked.append(np.stack(numbers))
        return coefficient(*numbers)

    for options in ({"order": 4}, {"contact_mode": "steps"}):
        scene = thrown(law)
        asked.clear()
        cvi.simulate(scene, None, speeds(scene), 0.8, dt=0.005, **options)
        numbers = np.concatenate(asked, axis=1)
        assert np.isfinite(numbers).all()
        assert numbers[:2].min() >= 0.0


def test_a_stored_scene_lists_it_as_missing():
    again = cvi.Scene.from_dict(thrown().to_dict())
    assert any("law of contact" in name for name in again.missing)
