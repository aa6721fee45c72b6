"""Laws of compliant pairs given by functions, against the built-in law and DOP853."""

from __future__ import annotations

import ctypes

import numpy as np
import pinocchio as pin
import pytest
from scipy.interpolate import CubicSpline

import contactvi as cvi
from helpers.compliant_scenes import MASS, RADIUS, ball, table
from oracles import compliant_law

HEIGHT, DURATION = 0.1, 0.5
STEPS = {2: (1000, 2000, 4000), 4: (500, 1000, 2000), 8: (200, 400, 800)}
TOLD = {2: 5e-4, 4: 1e-6, 8: 2e-9}
ORACLE = 2e-11  # of the integration of the oracle over some contacts

# Stress over strain of a foam that is stiff, yields and is stiff again, in newtons over metres.
DEPTHS = np.array([0.0, 0.002, 0.004, 0.008, 0.014, 0.02, 0.03])
FORCES = np.array([0.0, 6.0, 9.0, 12.0, 25.0, 60.0, 240.0])
FOAM = CubicSpline(DEPTHS, FORCES)


def hunt_crossley(k: float, n: float, c: float):
    return (
        lambda d, rate: k * d**n * (1.0 + c * rate),
        lambda d, rate: (n * k * d ** (n - 1.0) * (1.0 + c * rate), c * k * d**n),
        lambda d: k * d ** (n + 1.0) / (n + 1.0),
    )


def foam(d, rate):
    """Its damping is that of air that is pressed out: it grows with the depth."""
    return FOAM(d) + 40.0 * d * rate


LAWS = {
    "lankarani-nikravesh": compliant_law.lankarani_nikravesh(1e5, 0.7, np.sqrt(2.0 * 9.81 * HEIGHT)),
    "exponential": lambda d, rate: 20.0 * np.expm1(d / 0.004) * (1.0 + 0.2 * rate),
    "voigt": lambda d, rate: 2e3 * d + 6.0 * rate,  # it jumps where it begins, and ends before the shapes are apart
}
VECTORS = LAWS | {
    "lankarani-nikravesh": lambda d, rate: 1e5 * d**1.5 * (1.0 + 0.75 * 0.51 * rate / np.sqrt(2.0 * 9.81 * HEIGHT))
}


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("order", STEPS)
def test_a_ball_that_drops_keeps_the_order(name, order):
    """As of the built-in laws (test_compliant_pairs.py): where openings lie in their steps may take .7 of the order."""
    z, v, changes = compliant_law.dropped(LAWS[name], MASS, HEIGHT, DURATION)
    scene, errors = ball(HEIGHT, law=VECTORS[name]), []
    for steps in STEPS[order]:
        traj = cvi.simulate(scene, None, None, DURATION, dt=DURATION / steps, order=order)
        assert traj.stats.switches == changes >= 2
        errors.append(max(abs(traj.q[-1, 2] - RADIUS - z), abs(traj.v[-1, 2] - v)))
    assert errors[-1] <= TOLD[order]
    for n, error in zip(STEPS[order][1:], errors[1:], strict=True):
        assert error <= max(ORACLE, errors[0] * (STEPS[order][0] / n) ** (order - 0.7))


def test_a_table_of_a_foam():
    """Cubic pieces: at a knot the third derivative jumps, where nothing is located, so that order 4 has 4 there."""
    z, v, changes = compliant_law.dropped(lambda d, rate: float(foam(d, rate)), MASS, HEIGHT, DURATION)
    traj = cvi.simulate(ball(HEIGHT, law=foam), None, None, DURATION, dt=2e-4, order=4)
    assert traj.stats.switches == changes
    assert traj.q[-1, 2] - RADIUS == pytest.approx(z, abs=1e-8)
    assert traj.v[-1, 2] == pytest.approx(v, abs=1e-7)


@pytest.mark.parametrize("order", [2, 4, 6, 8])
@pytest.mark.parametrize(("k", "n", "c"), [(1e5, 1.5, 0.3), (2e3, 1.0, 0.5)])
def test_hunt_and_crossley_is_the_built_in_law(order, k, n, c):
    """With its derivatives and potential, to the tolerance of the stage equations over the steps."""
    law, derivatives, potential = hunt_crossley(k, n, c)
    given = ball(HEIGHT, law=law, derivatives=derivatives, potential=potential, friction=0.3)
    own = ball(HEIGHT, stiffness=k, exponent=n, damping=c, friction=0.3)
    v = own.velocity({"ball": ((0.3, 0.0, 0.0), (0.0, 2.0, 0.0))})
    one, other = (cvi.simulate(scene, None, v, 0.4, dt=1e-3, order=order) for scene in (given, own))
    assert one.stats.switches == other.stats.switches
    assert np.abs(one.q - other.q).max() <= 1e-9
    assert np.abs(one.v - other.v).max() <= 1e-8
    assert np.abs(one.potential_energy - other.potential_energy).max() <= 1e-8
    assert np.abs(one.ledger.energy_balance - other.ledger.energy_balance).max() <= 1e-9
    forces = [traj.compliant_contacts().force for traj in (one, other)]
    assert np.abs(forces[0] - forces[1]).max() <= 1e-7 * np.abs(forces[1]).max()


def test_without_a_potential_all_is_work():
    """What the spring takes and gives back is in the damping, and the balance closes as it does with one."""
    law, derivatives, potential = hunt_crossley(2e3, 1.0, 0.5)
    with_one = cvi.simulate(ball(HEIGHT, law=law, potential=potential), None, None, DURATION, dt=1e-3, order=8)
    without = cvi.simulate(ball(HEIGHT, law=law, derivatives=derivatives), None, None, DURATION, dt=1e-3, order=8)
    for traj in (with_one, without):
        assert np.abs(traj.ledger.energy_balance).max() <= 1e-8
    elastic = np.array([0.5 * 2e3 * max(0.0, RADIUS - z) ** 2 for z in with_one.q[:, 2]])
    assert without.work.damping == pytest.approx(with_one.work.damping + elastic, abs=1e-8)


class Compiled:
    """An object with the address of a C function, as numba.cfunc makes them."""

    def __init__(self, kind, function):
        self._kept = kind(function)
        self.address = ctypes.cast(self._kept, ctypes.c_void_p).value


OF_TWO = ctypes.CFUNCTYPE(None, ctypes.c_double, ctypes.c_double, ctypes.POINTER(ctypes.c_double))
OF_ONE = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)


def test_a_compiled_law():
    law, derivatives, potential = hunt_crossley(1e5, 1.5, 0.3)

    def fill(depth, rate, values):
        values[0] = law(depth, rate)
        values[1], values[2] = derivatives(depth, rate)

    compiled = {"law": Compiled(OF_TWO, fill), "potential": Compiled(OF_ONE, potential)}
    one = cvi.simulate(ball(HEIGHT, **compiled), None, None, 0.3, dt=1e-3, order=4)
    other = cvi.simulate(
        ball(HEIGHT, law=law, derivatives=derivatives, potential=potential), None, None, 0.3, dt=1e-3, order=4
    )
    assert np.abs(one.q - other.q).max() <= 1e-12
    assert np.abs(one.energy - other.energy).max() <= 1e-12


def test_one_call_is_for_all_contacts():
    """Of the four feet of a table, which rests at last."""
    most = 0

    def law(depth, rate):
        nonlocal most
        most = max(most, np.count_nonzero(rate)) if len(depth) < 20 else most
        return 5e4 * depth * (1.0 + 20.0 * rate)

    scene = table(2.0, law=law)
    traj = cvi.simulate(scene, None, None, 1.0, dt=1e-3, order=4)
    found = traj.compliant_contacts()
    last = found.node == found.node.max()
    assert most >= 4
    assert found.normal_force[last].sum() == pytest.approx(2.0 * 9.81, rel=1e-3)


def derivative_cases():
    law, derivatives, _ = hunt_crossley(5e3, 1.5, 0.3)
    rolling = {"friction": 0.4, "slip_speed": 0.05}
    speeds = {"ball": ((0.3, 0.1, -0.2), (0.5, 2.0, -1.0))}
    return {
        "given": (ball(0.02, law=law, derivatives=derivatives, **rolling), speeds),
        "by differences": (ball(0.02, law=law, **rolling), speeds),
        "exponential": (ball(0.02, law=LAWS["exponential"], **rolling), speeds),
    }


@pytest.mark.thinned(2)
@pytest.mark.parametrize("order", [2, 4, 8])
@pytest.mark.parametrize("name", ["given", "by differences", "exponential"])
def test_derivatives_are_those_of_differences(name, order):
    scene, speeds = derivative_cases()[name]
    q, v = scene.neutral(), scene.velocity(speeds)
    weights, none = np.linspace(0.5, 1.5, scene.nv), np.zeros(scene.nv)

    def run(dq, dv, **options):
        start = pin.integrate(scene.model, q, dq)
        return cvi.simulate(scene, start, v + dv, 0.12, dt=5e-4, order=order, solver_tol=1e-14, **options)

    traj = run(none, none, record="gradient")
    assert traj.stats.switches >= 1
    _, found = cvi.gradient(traj, (none, weights))
    close = {2: 5e-3, 4: 2e-4}.get(order, 1e-5) * float(max(np.abs(found["q0"]).max(), 1.0))
    step = 1e-5
    for key, place in (("q0", 0), ("v0", 1)):
        for k in range(scene.nv):
            direction = step * np.eye(scene.nv)[k]
            ends = [run(*((none,) * place), s * direction, *((none,) * (1 - place))).v[-1] for s in (1, -1, 2, -2)]
            change = 8.0 * (ends[0] - ends[1]) - (ends[2] - ends[3])
            assert found[key][k] == pytest.approx(weights @ change / (12.0 * step), abs=close)


def test_linearize_is_that_of_the_built_in_law():
    law, derivatives, _ = hunt_crossley(5e3, 1.5, 0.3)
    scenes = (ball(0.02, law=law, derivatives=derivatives), ball(0.02, stiffness=5e3, exponent=1.5, damping=0.3))
    q = scenes[0].neutral()
    q[2] = RADIUS - 0.004
    v = scenes[0].velocity({"ball": ((0.3, 0.0, -0.2), (0.0, 2.0, 0.0))})
    one, other = (cvi.linearize(scene, q, v)[0] for scene in scenes)
    assert np.allclose(one, other, rtol=1e-9, atol=1e-9)


def test_a_force_that_jumps_is_run_and_has_no_derivative():
    traj = cvi.simulate(ball(HEIGHT, law=LAWS["voigt"]), None, None, 0.3, dt=1e-3, order=4, record="gradient")
    with pytest.raises(cvi.NotDifferentiable):
        cvi.gradient(traj, (np.zeros(6), np.ones(6)))


def test_a_stored_scene_asks_for_its_law_again(tmp_path):
    law, derivatives, potential = hunt_crossley(1e5, 1.5, 0.3)
    scene = ball(HEIGHT, law=law, derivatives=derivatives, potential=potential)
    traj = cvi.simulate(scene, None, None, 0.3, dt=1e-3, order=4)
    traj.save(tmp_path / "run.npz")
    again = cvi.Trajectory.load(tmp_path / "run.npz").scene
    assert again.compliant_pairs == scene.compliant_pairs
    assert len(again.missing) == 1
    with pytest.raises(cvi.SceneError, match="compliance of"):
        cvi.simulate(again, None, None, 0.3, dt=1e-3, order=4)
    again.set_compliance("ball", "ground", law=law, derivatives=derivatives, potential=potential)
    assert again.missing == []
    assert np.array_equal(cvi.simulate(again, None, None, 0.3, dt=1e-3, order=4).q, traj.q)
    assert any("function of the depth" in note.text for note in scene.report.notes)


@pytest.mark.parametrize(
    ("law", "words"),
    [
        ({"law": 3.0}, "no function"),
        ({"law": lambda d, r: d, "stiffness": 1.0}, "stiffness"),
        ({"law": lambda d, r: d, "damping": 1.0}, "damping"),
        ({"law": lambda d, r: d - 1e-3}, "pulls at rest"),
        ({"law": lambda d, r: np.sqrt(d)}, "slope without bounds"),
        ({"law": lambda d, r: d, "derivatives": lambda d, r: (2.0 + 0 * d, 0 * d)}, "not its own"),
        ({"law": lambda d, r: d, "potential": lambda d: d**2}, "slope of its potential"),
        ({"stiffness": 1.0, "potential": lambda d: d**2}, "potential"),
        ({"friction": 0.3}, "no force"),
    ],
)
def test_what_is_refused(law, words):
    with pytest.raises(cvi.InputError, match=words):
        ball(HEIGHT, **law)


@pytest.mark.parametrize(
    "law", [lambda d, r: 1.0, lambda d, r: 1 / 0, lambda d, r: np.log(-1.0 - d), lambda d, r: "x", lambda d: d]
)
def test_functions_that_fail_say_so(law):
    with np.errstate(invalid="ignore"), pytest.raises(cvi.UserFunctionError, match="law of a compliance"):
        ball(HEIGHT, law=law)


def test_a_law_that_fails_in_a_run_ends_it():
    def law(depth, rate):
        if np.any((depth > 5e-3) & (rate > 0.5) & (depth < 9e-3)):
            raise ValueError("too deep")
        return 1e3 * depth

    with pytest.raises(cvi.UserFunctionError, match="too deep"):
        cvi.simulate(ball(HEIGHT, law=law), None, None, 0.3, dt=1e-3, order=4)


def test_two_sides_with_functions_have_to_be_one():
    scene = cvi.Scene()
    scene.add_sphere("one", 0.05)
    scene.add_sphere("two", 0.05, placement=(0.0, 0.0, 0.2))
    for name in ("one", "two"):
        scene.set_compliance(name, law=lambda d, r: 1e3 * d)
    with pytest.raises(cvi.SceneError, match="softer"):
        scene.built()


def test_in_threads_and_islands():
    """A batch in threads has the bits of single runs."""
    scene = ball(0.05, law=LAWS["exponential"], friction=0.2)
    v = np.array([scene.velocity({"ball": (0.1, 0.0, -s)}) for s in (0.1, 0.4, 0.7)])
    batch = cvi.simulate_batch(scene, [scene.neutral()] * 3, v, duration=0.2, dt=1e-3, order=4)
    for k in range(3):
        assert np.array_equal(batch.q[k], cvi.simulate(scene, None, v[k], 0.2, dt=1e-3, order=4).q)


def sliding_box(**law) -> tuple[cvi.Scene, np.ndarray, np.ndarray]:
    """A box of 2 kg that slides at 1 m/s on four corners, as deep as it rests; its scene and state."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", (0.4, 0.4, 0.02), 2.0)
    scene.set_compliance("box", "ground", stiffness=1e5, damping=2.0, **law)
    q = scene.configuration({"box": (0.0, 0.0, 0.01 - 2.0 * 9.81 / 4e5)})
    return scene, q, scene.velocity({"box": (1.0, 0.0, 0.0)})


def test_friction_that_saturates_slows_a_box_by_as_much():
    """Each corner carries more than the 2.4 N at which its friction has its bound of 1.2 N: 4.8 N / 2 kg."""
    scene, q, v = sliding_box(friction_bound=lambda normal, slip: np.minimum(0.5 * normal, 1.2))
    traj = cvi.simulate(scene, q, v, 0.3, dt=1e-3, order=4)
    assert traj.compliant_contacts().normal_force.min() > 2.4
    assert traj.v[:, 0] == pytest.approx(1.0 - 2.4 * traj.t, abs=1e-5)
    assert np.all(np.diff(traj.work.damping) > 0.0)
    assert np.abs(traj.ledger.energy_balance).max() <= 1e-6


@pytest.mark.parametrize("order", [2, 4])
def test_a_bound_of_coulomb_is_coulombs(order):
    ends = []
    for law in ({"friction": 0.3}, {"friction_bound": lambda normal, slip: 0.3 * normal}):
        scene, q, v = sliding_box(**law)
        v[5] = 2.0  # it turns as well
        ends.append(cvi.simulate(scene, q, v, 0.2, dt=1e-3, order=order).v[-1])
    assert np.abs(ends[0] - ends[1]).max() <= 1e-9


def test_friction_by_normal_force_and_slip_has_derivatives():
    scene = ball(
        0.02, stiffness=5e3, exponent=1.5, damping=0.3, slip_speed=0.05,
        friction_bound=lambda normal, slip: 0.4 * normal / (1.0 + normal / 30.0) * (1.0 + 0.5 * np.exp(-slip)),
    )  # fmt: skip
    q, v = scene.neutral(), scene.velocity({"ball": ((0.3, 0.1, -0.2), (0.5, 2.0, -1.0))})
    weights, none, step = np.linspace(0.5, 1.5, 6), np.zeros(6), 1e-5

    def run(dv, **options):
        return cvi.simulate(scene, q, v + dv, 0.12, dt=5e-4, order=4, solver_tol=1e-14, **options)

    traj = run(none, record="gradient")
    assert traj.stats.switches >= 1
    _, found = cvi.gradient(traj, (none, weights))
    for k in range(6):
        ends = [run(s * step * np.eye(6)[k]).v[-1] for s in (1, -1, 2, -2)]
        change = 8.0 * (ends[0] - ends[1]) - (ends[2] - ends[3])
        assert found["v0"][k] == pytest.approx(weights @ change / (12.0 * step), abs=2e-4)


def test_bounds_that_are_refused():
    with pytest.raises(cvi.UserFunctionError, match="negative"):
        sliding_box(friction_bound=lambda normal, slip: normal - 1.0)
    with pytest.raises(cvi.InputError, match="friction"):
        sliding_box(friction_bound=lambda normal, slip: normal, friction=0.3)
    scene = sliding_box(friction_bound=lambda normal, slip: 0.3 * normal)[0]
    assert any("compliance of" in name for name in cvi.Scene.from_dict(scene.to_dict()).missing)
