"""Friction as a function of slip, normal force and time, against closed forms and DOP853."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from batteries.test_law_battery import of_state
from contactvi.verify import systems
from oracles.event_ode import leg
from oracles.held_contact import RodOnTip

MASS, G, RADIUS = 2.0, 9.81, 0.05
REFERENCE, MU = 10.0, 0.5  # of rubber's law [N]


def rubber(slip, normal, t):
    """Its friction force is MU REFERENCE^(1/3) normal^(2/3): Hertz's contact area times a shear strength."""
    return MU * (normal / REFERENCE) ** (-1.0 / 3.0)


def rubber_slopes(slip, normal, t):
    return 0.0 * slip, -rubber(slip, normal, t) / (3.0 * normal), 0.0 * t


def force(normal: float) -> float:
    return MU * REFERENCE ** (1.0 / 3.0) * normal ** (2.0 / 3.0)


def point(law=rubber, gravity=(0.0, 0.0, -G), restitution=0.0, height=0.0) -> cvi.Scene:
    """A ball that cannot turn, on a plane: a point with a mass."""
    model = pin.Model()
    model.gravity.linear = np.array(gravity, dtype=float)
    joint = 0
    for kind, name in ((pin.JointModelPX(), "x"), (pin.JointModelPY(), "y"), (pin.JointModelPZ(), "z")):
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), name)
    model.appendBodyToJoint(joint, pin.Inertia(MASS, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
    above = pin.SE3(np.eye(3), np.array([0.0, 0.0, RADIUS + height]))
    shapes = {
        "ground": (0, pin.SE3.Identity(), systems.halfspace(0.0, 0.0, 1.0)),
        "ball": (joint, above, coal.Sphere(RADIUS)),
    }
    scene = systems.built(model, shapes, [("ground", "ball")], restitution)
    scene.set_contact("ground", "ball", friction_of_state=law)
    return scene


# A dense step has the friction of its impulses, each of which is the force of half of the step: exact where it is
# constant. Steps that slide and stick are found to rounding.
@pytest.mark.parametrize("options", [{"order": 2}, {"order": 4}, {"order": 8}, {"contact_mode": "steps"}], ids=str)
def test_a_slide_down_an_incline(options):
    slope = 0.5
    scene = point(gravity=(G * math.sin(slope), 0.0, -G * math.cos(slope)))
    load = MASS * G * math.cos(slope)
    a = G * math.sin(slope) - force(load) / MASS
    assert a > 0.5
    run = cvi.simulate(scene, np.zeros(3), np.array([0.1, 0.0, 0.0]), 0.5, dt=0.01, **options)
    close = 1e-6 if "contact_mode" in options else 1e-11  # a dense step is solved to 1e-8 of the free speeds
    np.testing.assert_allclose(run.v[-1], [0.1 + 0.5 * a, 0.0, 0.0], atol=close)
    np.testing.assert_allclose(run.q[-1], [0.05 + 0.125 * a, 0.0, 0.0], atol=close)
    if "contact_mode" not in options:
        heat = force(load) * run.q[-1][0]
        assert run.friction_loss[-1] == pytest.approx(heat, rel=1e-9)
        assert abs(run.ledger.energy_balance).max() <= 1e-9


def test_given_derivatives_and_compiled_functions_change_nothing():
    class Compiled:
        def __init__(self):
            double = ctypes.c_double

            def law(slip, normal, t, values):
                values[0] = rubber(slip, normal, t)
                values[1], values[2], values[3] = rubber_slopes(slip, normal, t)

            self._kept = ctypes.CFUNCTYPE(None, double, double, double, ctypes.POINTER(double))(law)
            self.address = ctypes.cast(self._kept, ctypes.c_void_p).value

    runs = []
    for law in (rubber, (rubber, rubber_slopes), Compiled()):
        scene = point(law, gravity=(3.0, 0.0, -G))
        runs.append(cvi.simulate(scene, np.zeros(3), np.array([0.5, 0.2, 0.0]), 0.3, dt=0.01, order=4).q)
    # numpy's power of arrays and of numbers may differ in the last digit.
    np.testing.assert_allclose(runs[1], runs[0], atol=1e-14)
    np.testing.assert_allclose(runs[2], runs[0], atol=1e-14)


# --- a block that is pressed and pulled ------------------------------------------------------------------------------
def pressed(t: float) -> float:
    return MASS * G + 15.0 * math.sin(7.0 * t)


def pulled(t: float) -> float:
    return 13.0 * math.sin(4.0 * t)


def pressed_block(t_end: float) -> tuple[np.ndarray, list[tuple[float, str]]]:
    """Place and velocity at t_end of the block that starts at rest, with the times at which it slips and sticks."""
    t, y, mode, log = 0.0, np.zeros(2), "sticks", []
    while t < t_end:
        if mode == "sticks":
            piece = leg(lambda t, y: np.array([1.0]), t, [t], t_end,
                        [(lambda t, y: abs(pulled(t)) - force(pressed(t)), 1)])  # fmt: skip
            t, side = piece.t, math.copysign(1.0, pulled(piece.t))
            mode = "slips"
        else:

            def rate(t: float, y: np.ndarray, side: float = side) -> np.ndarray:
                return np.array([y[1], (pulled(t) - side * force(pressed(t))) / MASS])

            def stops(t: float, y: np.ndarray, side: float = side, since: float = t) -> float:
                return side * y[1] if t > since + 1e-3 else 1.0

            piece = leg(rate, t, y, t_end, [(stops, -1)])
            t, y = piece.t, np.array([piece.y[0], 0.0 if piece.event is not None else piece.y[1]])
            mode = "sticks"
            assert piece.event is None or abs(pulled(t)) < force(pressed(t))  # it stays for a while
        if piece.event is not None:
            log.append((t, mode))
    return y, log


def pressed_scene(law=rubber) -> cvi.Scene:
    scene = point(law)
    scene.add_force(lambda t, q, v: np.array([pulled(t), 0.0, MASS * G - pressed(t)]), name="press and pull")
    return scene


CONTACT = 1e-3  # [s] of the contact steps that hold what sticks here: a slip begins at the end of one, or of the next


def test_a_block_that_is_pressed_and_pulled():
    """Slip and stick alternate."""
    known, log = pressed_block(1.4)
    assert [mode for _, mode in log] == ["slips", "sticks", "slips"]
    # A slip that begins later than it should by CONTACT has an error of its force, which grows from zero, times that.
    # The contact steps at rest have no error. Order 2 has that of its steps.
    for order, dt, close in ((2, 0.005, 1e-4), (4, 0.04, 5e-6), (8, 0.1, 5e-6)):
        run = cvi.simulate(pressed_scene(), np.zeros(3), np.zeros(3), 1.4, dt=dt, order=order)
        np.testing.assert_allclose([run.q[-1][0], run.v[-1][0]], known, atol=close)
        assert np.diff(run.friction_loss).min() >= -1e-12
        changes = [(row.time, row.change) for row in run.contact_changes if row.change in ("slip", "stick")]
        np.testing.assert_allclose(
            [t for t, _ in changes], [t for t, _ in log], atol=1.5 * (dt if order == 2 else CONTACT)
        )
        assert [change + "s" for _, change in changes] == [mode for _, mode in log]


def test_the_order_with_a_load_in_time():
    """A block that slides under a load that swings, until it is at rest: errors fall with the order of the method."""
    v0, t_end = 2.5, 0.9

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        return np.array([y[1], -force(pressed(t)) / MASS])

    rest = leg(rate, 0.0, [0.0, v0], t_end, [(lambda t, y: y[1], -1)])
    assert rest.event is not None
    for order, dt, least in ((2, 0.02, 1.7), (4, 0.05, 3.5), (8, 0.15, 6.5)):
        errors = []
        for factor in (1.0, 0.5):
            scene = point()
            scene.add_force(lambda t, q, v: np.array([0.0, 0.0, MASS * G - pressed(t)]), name="press")
            run = cvi.simulate(scene, np.zeros(3), np.array([v0, 0.0, 0.0]), t_end, dt=factor * dt, order=order)
            errors.append(abs(run.q[-1][0] - rest.y[0]))
        assert math.log2(errors[0] / errors[1]) >= least


def test_dense_steps_of_the_same_block():
    """To the first order: the coefficient is that of the slip at the start, and slips begin and end with a step."""
    known, _ = pressed_block(1.4)
    errors = []
    for dt in (2e-3, 5e-4):
        run = cvi.simulate(pressed_scene(), np.zeros(3), np.zeros(3), 1.4, dt=dt, contact_mode="steps")
        errors.append(np.abs([run.q[-1][0], run.v[-1][0]] - known).max())
    # Each of two slips may begin a step late: by then the force has grown from zero, by at most 13 N * 4 / s of it.
    for error, dt in zip(errors, (2e-3, 5e-4), strict=True):
        assert error <= 2 * 0.5 * 13.0 * 4.0 / MASS * dt**2
    assert errors[1] <= 0.5 * errors[0]


@pytest.mark.parametrize(("order", "dt"), [(2, 0.005), (4, 0.02), (8, 0.05)])
def test_a_surface_that_gets_wet(order, dt):
    """What sticks on an incline begins to slide when the coefficient, which falls with the time, has come to tan."""
    slope, start, fall = 0.45, 0.6, 0.3
    scene = point(lambda slip, normal, t: start - fall * t, (G * math.sin(slope), 0.0, -G * math.cos(slope)))
    begins = (start - math.tan(slope)) / fall
    later = 1.0 - begins
    assert 0.2 < begins < 0.6
    run = cvi.simulate(scene, np.zeros(3), np.zeros(3), 1.0, dt=dt, order=order)
    slips = [row.time for row in run.contact_changes if row.change == "slip"]
    late = 1.5 * (dt if order == 2 else CONTACT)
    np.testing.assert_allclose(slips, [begins], atol=late)
    close = 0.5 * G * math.cos(slope) * fall * late**2  # the speed that it would have by then
    assert run.v[-1][0] == pytest.approx(0.5 * G * math.cos(slope) * fall * later**2, abs=close)
    assert run.q[-1][0] == pytest.approx(G * math.cos(slope) * fall * later**3 / 6.0, abs=close)


# --- a rod whose load depends on its friction ------------------------------------------------------------------------
@dataclass(frozen=True)
class RodWithLaw(RodOnTip):
    """The friction is law(slip, normal), found together with the normal force."""

    law: Callable[[float, float], float] = None

    def forces(self, mode, y):
        rod = RodOnTip(0.3, self.tip, self.length)
        if mode == "sticks":
            return rod.forces(mode, y)
        for _ in range(100):
            normal, tangential = rod.forces(mode, y)
            rod = replace(rod, friction=self.law(abs(self.slip(y)), normal))
        return normal, tangential

    def guards(self, mode):
        if mode != "sticks":
            return super().guards(mode)

        def spare(_t, y):
            normal, tangential = self.forces("sticks", y)
            return self.law(0.0, normal) * normal - abs(tangential)

        return [spare]

    def after(self, mode, _guard, _t, y):
        normal, tangential = self.forces("sticks", y)
        if mode != "sticks" and abs(tangential) <= self.law(0.0, normal) * normal:
            return "sticks"
        return "forward" if tangential < 0.0 else "backward"


def test_a_falling_rod():
    """The normal force of a rod that falls, its tip on the ground, is found with the friction that it causes."""

    def law(slip, normal, t=0.0):
        return 0.35 * (normal / 5.0) ** (-1.0 / 3.0) * (1.0 + 0.5 * np.exp(-4.0 * slip))

    theta, tip, speed = 1.0, 0.02, 1.5
    rod = RodWithLaw(0.0, tip, 1.0, law)
    states, changes = rod.states(np.array([0.0, theta, speed, 0.0]), np.array([0.0, 0.4]))
    assert not changes  # it slides on
    for order, dt, close, least in ((2, 0.01, 1e-3, 1.6), (4, 0.02, 1e-5, 3.3), (8, 0.04, 1e-8, 6.0)):
        errors = []
        for factor in (1.0, 0.5):
            scene, q = systems.rod_on_ground(theta, tip, 0.0, 0.3, G)
            scene.set_contact(friction_of_state=law)
            run = cvi.simulate(scene, q, np.array([speed, 0.0, 0.0]), 0.4, dt=factor * dt, order=order)
            found = [run.q[-1][0], -run.q[-1][2], run.v[-1][0], -run.v[-1][2]]
            errors.append(np.abs(found - states[-1]).max())
        assert errors[1] <= close
        assert math.log2(errors[0] / errors[1]) >= least


# --- impacts ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("process", ["two-phase", "incremental"])
def test_an_impact_has_an_infinite_force(process):
    """It has the friction that the law gives there, by its slip before and its time."""

    def law(slip, normal, t):
        return np.where(np.isinf(normal), 0.1 + 0.05 * slip + 0.1 * t, 5.0)

    height, e, v0 = 0.3, 0.6, 1.5
    scene = point(law, restitution=e, height=height)
    scene.set_contact("ground", "ball", impact_process=process)
    time, closing = math.sqrt(2.0 * height / G), math.sqrt(2.0 * height * G)
    mu = 0.1 + 0.05 * v0 + 0.1 * time
    run = cvi.simulate(scene, np.zeros(3), np.array([v0, 0.0, 0.0]), 0.3, dt=0.01)
    assert len(run.events) == 1
    assert run.v[-1][0] == pytest.approx(v0 - mu * (1.0 + e) * closing, rel=1e-9)


# --- what is asked and what is refused -------------------------------------------------------------------------------
def test_no_nonsense_is_asked():
    asked = []

    def law(*numbers):
        asked.append(np.stack(numbers))
        return np.where(np.isinf(numbers[1]), 0.3, rubber(*numbers))

    for options in ({"order": 2}, {"order": 4}, {"contact_mode": "steps"}):
        scene = point(law, restitution=0.5, height=0.02)
        asked.clear()
        cvi.simulate(scene, np.zeros(3), np.array([1.0, 0.0, 0.0]), 0.6, dt=0.005, **options)
        slip, normal, t = np.concatenate(asked, axis=1)
        assert np.isfinite(slip).all()
        assert slip.min() >= 0.0
        assert not np.isnan(normal).any()
        assert normal.min() > 0.0
        assert t.min() >= 0.0
        assert t.max() <= 0.6 + 1e-12


def test_what_is_refused():
    scene = point()
    with pytest.raises(cvi.InputError, match="Friction is given twice"):
        scene.set_contact("ground", "ball", friction=0.3, friction_of_state=rubber)
    with pytest.raises(cvi.InputError, match="no function"):
        point(0.5)
    with pytest.raises(cvi.InputError, match="no value in an impact"):
        point(lambda slip, normal, t: np.where(np.isinf(normal), np.nan, 0.5))
    with pytest.raises(cvi.UserFunctionError, match="negative"):
        point(lambda slip, normal, t: 0.5 - 0.01 * normal)
    with pytest.raises(cvi.InputError, match="derivatives of the law of friction are not its own"):
        point((rubber, lambda slip, normal, t: (0.0 * t, 0.0 * t, 0.0 * t)))
    scene = point()
    scene.set_contact("ground", "ball", spinning_radius=0.01)
    with pytest.raises(cvi.SceneError, match="beside another law"):
        scene.built()
    scene = point()
    scene.set_contact("ground", "ball", static_friction=0.9)
    with pytest.raises(cvi.SceneError, match="two laws"):
        scene.built()
    later = point(lambda slip, normal, t: np.where(t > 0.31, -0.5, 0.5), (3.0, 0.0, -G))
    for options in ({"order": 2}, {"order": 4}, {"contact_mode": "steps"}):
        with pytest.raises(cvi.UserFunctionError, match="negative"):
            cvi.simulate(later, np.zeros(3), np.array([1.0, 0.0, 0.0]), 0.5, dt=0.01, **options)


def test_a_later_number_replaces_it_and_stored_scenes_miss_it():
    scene = point()
    again = cvi.Scene.from_dict(scene.to_dict())
    assert any("law of contact" in name for name in again.missing)
    scene.set_contact("ground", "ball", friction=0.2)
    run = cvi.simulate(scene, np.zeros(3), np.array([1.0, 0.0, 0.0]), 0.2, dt=0.01, order=4)
    assert run.v[-1][0] == pytest.approx(1.0 - 0.2 * G * 0.2, abs=1e-12)


# --- a battery; that of located contact is tests/batteries/test_law_battery.py ----------------------------------------
@pytest.mark.parametrize("seed", range(8))
def test_dense_steps_dissipate(seed):
    """Boxes and balls thrown on each other, with laws drawn at random."""
    random = np.random.default_rng(seed)
    scene = cvi.Scene()
    scene.add_halfspace(name="ground")
    scene.add_box("box", (0.2, 0.3, 0.1), mass=1.5, placement=(0.0, 0.0, 0.12))
    scene.add_sphere("ball", 0.1, mass=0.8, placement=(0.05, 0.02, 0.35))
    scene.add_capsule("rod", 0.05, 0.3, mass=0.5, placement=(0.6, 0.0, 0.3))
    scene.set_contact(restitution=0.3)
    for pair in (("ground", "box"), ("ground", "ball"), ("box", "ball"), ("ground", "rod")):
        scene.set_contact(*pair, **of_state(random)[0])
    v = random.uniform(-1.0, 1.0, scene.nv)
    run = cvi.simulate(scene, None, v, 0.6, dt=0.004, contact_mode="steps")
    assert run.status.ok
    assert len(run.dense_steps["t"]) > 0
    # Dense steps tell their losses by their energy, to what their own error is.
    assert np.all(run.dense_steps["energy_loss"] >= -run.dense_steps["energy_error"])
