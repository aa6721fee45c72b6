"""What is set for the contacts of a scene: restitution, friction, laws, compliance, and which pairs are tested."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any

from numpy.typing import ArrayLike

from contactvi.aliases import callers
from contactvi.errors import InputError, UnusedSettingWarning
from contactvi.keywords import refusing_methods
from contactvi.scene.body_adhesion import BodyAdhesion, check_body
from contactvi.scene.build import Built
from contactvi.scene.compliance import Compliance, compliance_name
from contactvi.scene.contact_laws import checked_contact
from contactvi.scene.contact_rules import ContactRules
from contactvi.scene.element_list import ElementList
from contactvi.scene.notes import noted
from contactvi.scene.pairs import ENABLED_BY_USER, untested_reason
from contactvi.scene.parts import PartList
from contactvi.scene.selection import Selector
from contactvi.scene.surface_motion import SurfaceMotion


@refusing_methods
@noted
class SceneContacts:
    """The methods of a scene that say what its contacts do, and which pairs of shapes are tested."""

    _parts: PartList
    _contact: ContactRules
    _elements: ElementList
    _built: Built | None

    def set_contact(
        self,
        a: Selector | None = None,
        b: Selector | None = None,
        *,
        restitution: float | ArrayLike | Callable[[float], float] | None = None,
        friction: float | ArrayLike | Callable[[float], float] | None = None,
        friction_axis: ArrayLike | None = None,
        static_friction: float | None = None,
        adhesion: float | ArrayLike | Callable[[float], float] | None = None,
        restitution_law: str | None = None,
        impact_process: str | None = None,
        limit_energy: bool | None = None,
        tangential_restitution: float | None = None,
        spinning_radius: float | None = None,
        rolling_radius: float | None = None,
        restitution_of_state: Callable[..., Any] | tuple[Callable[..., Any], Callable[..., Any]] | None = None,
        friction_of_state: Callable[..., Any] | tuple[Callable[..., Any], Callable[..., Any]] | None = None,
    ) -> None:
        """Set restitution in [0, 1] and Coulomb friction >= 0 of contacts, by default 0.5 and 0, and their laws.

        Friction acts in impacts and in persistent contact. Without a and b: the scene's
        default (and, of restitution, that of joint limits). With a: of one body, part or geometry. With a and b: of the
        contacts between them. A pair uses its own value, else the smaller one of its two sides' values, else what
        an MJCF says (or a URDF, with add_urdf(contact_friction=True)), else the default. Warns (UnusedSettingWarning)
        of a default that the files of the scene leave to no pair: set_contact(part, restitution=...) replaces theirs;
        and where none of the pairs between a and b is tested. Laws (docs/guide/contact_laws.md) count in the
        same order.

        Args:
            a, b: of the contacts that are meant.
            restitution: a number, a table (n, 2) of closing speeds [m/s] and values, or a function of the closing speed
                (a compiled one by its `address`, as of numba.cfunc: float64(float64)).
            friction: Coulomb's coefficient; or, as of restitution, a table or a function of the speed of the slip
                (Stribeck), >= 0, which counts in an impact as well, by the slip before it; or two numbers > 0,
                along `friction_axis` and across it: friction is within the ellipse with these, and dissipates most.
            friction_axis: (3,), in the frame of a, which is one geometry then.
            static_friction: coefficient of what sticks in persistent contact, which begins to slide with `friction`;
                by default that of a slip of zero.
            adhesion: pull [N] up to which the surfaces stay together once they touch, by default 0, shared by as many
                points as have touched at once; the friction is that of the normal force and the pull together. Or a
                table (n, 2) of times [s] and pulls, or a function of the time.
            restitution_law: "poisson" (default), the ratio of the impulses of expansion and compression; "newton", of
                the speeds after and before; "energetic" (Stronge), whose square is the ratio of the works of the
                normal impulse. Without friction all three are the same.
            impact_process: "two-phase" (default), friction as in Glocker and Pfeiffer 1995; "incremental", an impact of
                one point with friction is followed through its impulse, in which the slip turns, stops and turns back
                (Routh 1905, Keller 1986). The energetic law always follows it.
            limit_energy: whether restitution is lowered where it would make energy, as Newton's may (default); the
                column fallback of the events says "gain" where it would, in both cases.
            tangential_restitution: in [0, 1], by default 0: where friction holds the point in the impact, its slip is
                reversed with this coefficient (Walton 1993).
            spinning_radius: r_s >= 0 [m], by default 0: friction of a point against spinning about its normal. The
                tangential force and the torque about the normal over r_s lie together in the ball of radius
                friction times normal force (Leine and Glocker 2003), so that a pure spin meets a torque of
                friction r_s times normal force.
            rolling_radius: r_r >= 0 [m], by default 0: friction against rolling, a torque along the tangents of at
                most r_r times the normal force. Both radii need friction > 0.
            restitution_of_state: restitution as a function law(closing, slip, t) of the closing speeds, the speeds of
                the slips before the impact [m/s] and the times [s], arrays (n,) each, returns (n,) in [0, 1]; in place
                of restitution. It needs friction > 0, with which that slip is found. Or a pair of it and of its
                derivatives, derivatives(closing, slip, t): three arrays (n,); or a C function by its `address`,
                void(double closing, double slip, double t, double values[4]), which sets the value and these.
            friction_of_state: Coulomb's coefficient as a function law(slip, normal, t) of the speeds of the slips
                [m/s], 0 of what sticks, the normal forces > 0 [N] of the points and the times [s], arrays (n,), returns
                (n,), >= 0; in place of friction. An impact has no force: there normal is infinite, and slip is that
                before it. Derivatives and C functions as of restitution_of_state.

        Raises:
            InputError: bad numbers; a law without a value in an impact, derivatives that are not its own.
            UserFunctionError: a law that fails, or returns another shape, nan, or values beyond their range.
        """
        if a is None and b is not None:
            a, b = b, None
        first = None if a is None else self._geometries(a, "a")
        second = None if b is None else self._geometries(b, "b")
        rules = self._contact
        numbers, laws = checked_contact(
            rules.laws, first, restitution, friction, friction_axis, adhesion, restitution_of_state, friction_of_state,
            static_friction=static_friction, restitution_law=restitution_law, impact_process=impact_process,
            limit_energy=limit_energy, tangential_restitution=tangential_restitution, spinning_radius=spinning_radius,
            rolling_radius=rolling_radius,
        )  # fmt: skip
        for what, value in numbers.items():
            rule = rules.restitution if what == "restitution" else rules.friction
            if first is None and rule.overrides_default(self._parts.names.geometries):
                warnings.warn(
                    f"No pair of shapes uses the default {what} {value:g}: the files give their own. "
                    f"set_contact(part, {what}={value:g}) replaces that of a part",
                    UnusedSettingWarning, stacklevel=callers(),
                )  # fmt: skip
            rule.set(first, second, value)
        for name, value in laws.items():
            rules.laws.set(name, first, second, value)
        if first is not None and second is not None and (numbers or laws):
            self._warn_if_untested(first, second)
        self._built = None

    def set_compliance(
        self,
        a: Selector,
        b: Selector | None = None,
        *,
        stiffness: float | None = None,
        exponent: float | None = None,
        damping: float = 0.0,
        friction: float | None = None,
        slip_speed: float = 1e-3,
        law: Callable[..., Any] | None = None,
        derivatives: Callable[..., Any] | None = None,
        potential: Callable[..., Any] | None = None,
        friction_bound: Callable[..., Any] | None = None,
    ) -> None:
        """Let contacts be compliant: a force by the depth d of their overlap, in place of impacts and rigid contact.

        The normal force is f = stiffness d^exponent (1 + damping d'), and never pulls (Hunt and Crossley, 1975), or a
        function of yours; the friction is friction f s / sqrt(s^2 + slip_speed^2) against the slip of speed s, where a
        function of yours may stand in the place of friction f. It acts
        at the midpoint of the nearest points, inside of the smooth steps of any order, which end where a contact begins
        to press or to be open. Compliant pairs may overlap in a start, also at the neutral pose; they are not among
        `pair_names`, and `Trajectory.compliant_contacts` tells their forces. Soft against rigid things at once, in any
        mixture.

        Shapes: a ball against a ball, capsule, box, cylinder, hull or halfspace; two capsules; a capsule, ellipsoid,
        box or hull against a halfspace, on which each end of the capsule and each corner presses by a law of its own,
        of this stiffness. Others are refused when the scene is made (EngineError).

        Args:
            a, b: bodies, parts or geometries. Without b: all pairs of a, but what is set for pairs counts more; of two
                sides with a law of their own the softer one counts.
            stiffness: [N/m^exponent]; None, without law: rigid again.
            exponent: 1 is a linear spring, the default, 1.5 Hertz's contact (1882), at least 1. With law: the power of
                the depth with which it begins, for the steps near there; by default it is found.
            damping: [s/m], >= 0. The restitution at the speed v is near 1 - 2/3 damping v where that is near 1.
            friction: Coulomb's coefficient, >= 0; None: that of the pair (`set_contact`).
            slip_speed: below which friction is viscous [m/s]. What rests on a slope creeps with about
                slip_speed tan(slope) / friction.
            law: the normal force, in place of stiffness and damping: law(depth, rate) [N] of the depths >= 0 [m] of
                many contacts and their rates [m/s], > 0 where shapes approach, arrays (n,) each, returns (n,). Where it
                is negative the contact opens. Or an object with the `address` of a C function
                void(double depth, double rate, double values[3]) that sets force and derivatives
                (numba.cfunc("void(float64, float64, CPointer(float64))")).
            derivatives: derivatives(depth, rate) of the law: (by the depth [N/m], by the rate [N s/m]), (n,) each;
                None: by differences.
            potential: potential(depth) [J], (n,), whose slope is the law at the rate 0; or the address of a C function
                double(double). It is part of the potential energy then; without one all that the law does is in the
                damping of the work (`Trajectory.work`).
            friction_bound: the largest friction, in place of friction times normal force: friction_bound(normal, slip)
                [N], >= 0, of the normal forces >= 0 [N] of many contacts and the speeds of their slips [m/s], returns
                (n,). Or a C function void(double normal, double slip, double values[3]) by its `address`.

        Raises:
            InputError: bad numbers; a law that pulls at rest, derivatives or a potential that are not its own.
            UserFunctionError: a law that fails, or returns another shape, or nan.
        """
        soft = None
        if stiffness is not None or law is not None:
            soft = Compliance.checked(
                stiffness, exponent, damping, friction, slip_speed, law, derivatives, potential, friction_bound
            )
        else:
            given: dict[str, Any] = {"exponent": exponent, "damping": damping or None, "friction": friction}
            given |= {"derivatives": derivatives, "potential": potential, "friction_bound": friction_bound}
            for name, value in given.items():
                if value is not None:
                    raise InputError(
                        f"A compliance with {name} has no force", name="stiffness", expected="stiffness= or law=",
                        got="none", remedy="Give one, or neither and nothing else: the pair is rigid then",
                    )  # fmt: skip
        first = self._geometries(a, "a")
        second = None if b is None else self._geometries(b, "b")
        self._contact.compliance.set(first, second, soft)
        others = list(self._parts.names.geometries) if second is None else second
        pairs = [(one, other) for one in first for other in others]
        self._elements.supply({compliance_name(pair) for a, b in pairs for pair in ((a, b), (b, a))})
        if second is not None:
            self._warn_if_untested(first, second)
        self._built = None

    def set_surface_velocity(
        self,
        a: Selector,
        linear: ArrayLike = (0.0, 0.0, 0.0),
        angular: ArrayLike = (0.0, 0.0, 0.0),
        *,
        profile: ArrayLike | Callable[[float], float] | None = None,
    ) -> None:
        """Let surfaces move along themselves while their bodies stay: a belt, a treadmill, a turntable.

        The surface has the velocity profile(t) (linear + angular x r) beside that of its body, r from the origin of the
        geometry. In contacts with friction, of every kind, the slip is counted from it; what of it is along the normal
        of a contact does not count. Its work is in the column driven_work of `Trajectory.work`. A velocity of zero
        takes it away.

        Args:
            a: of the bodies, parts or geometries.
            linear: [m/s], shape (3,), in the frame of the geometry.
            angular: [rad/s], shape (3,), in the frame of the geometry.
            profile: a table (n, 2) of times [s] and factors, or a function of the time (a compiled one by its
                `address`, as of numba.cfunc: float64(float64)). Smooth within steps, or with its kinks at
                their ends; it is asked for times of up to 1 ms before the run and after it as well.

        Raises:
            InputError: bad numbers, or no such body.
        """
        motion = SurfaceMotion.checked(linear, angular, profile)
        for name in self._geometries(a, "a"):
            if motion.moves:
                self._contact.surface_motions[name] = motion
            else:
                self._contact.surface_motions.pop(name, None)
        self._built = None

    def set_body_adhesion(self, body: Selector, pull: float | ArrayLike | Callable[[float], float]) -> None:
        """Let a body stick to whatever it touches: a gripper's pad, a foot of a climber.

        The pull acts along the normals of all contacts of the body, shared by as many points as have touched at once,
        beside the adhesion of their pairs (`set_contact(adhesion=)`), of which it is a kind. It replaces what was set
        for the body; 0 takes it away. An adhesion actuator of an MJCF (`PartHandle.actuators`, kind "adhesion")
        pulls with nothing until this is called, for example with `lambda t: actuator.force(ctrl(t))`.

        Args:
            body: one body that moves, with shapes.
            pull: [N], >= 0: a number, a table (n, 2) of times [s] and pulls, or a function of the time, which may read
                what a program changes between the steps of a `Simulator`.

        Raises:
            InputError: bad numbers, or no such body.
        """
        names = self._parts.names
        shapes = frozenset(self._geometries(body, "body"))
        collision = self._parts.assembly.collision.geometryObjects
        joints = {int(collision[names.geometries[name]].parentJoint) for name in shapes}
        bodies = [name for name, places in names.bodies.items() if {collision[k].name for k in places} & shapes]
        check_body(str(body), bodies, joints != {0})
        self._contact.set_body_adhesion(shapes, BodyAdhesion.checked(bodies[0], pull))
        self._built = None

    def _warn_if_untested(self, first: Sequence[str], second: Sequence[str]) -> None:
        """Warn where what is set for the pairs between these geometries has no effect, because none is tested."""
        index, rules = self._parts.names.geometries, self._contact
        disabled, enabled = ([(index[a], index[b]) for a, b in pairs] for pairs in (rules.disabled, rules.enabled))
        pairs = ((index[a], index[b]) for a in first for b in second if a != b)
        reason = untested_reason(self._parts.assembly, self._parts.parts, disabled, enabled, pairs)
        if reason is not None:
            more = f" (and {len(first) * len(second) - 1} more)" if len(first) * len(second) > 1 else ""
            remedy = ". scene.enable_pair(a, b), called before, tests it" if reason in ENABLED_BY_USER else ""
            warnings.warn(
                f"What is set for the contact of {first[0]!r} and {second[0]!r}{more} has no effect, because it is not "
                f"tested: {reason}{remedy}", UnusedSettingWarning, stacklevel=callers(),
            )  # fmt: skip

    def disable_pair(self, a: Selector, b: Selector) -> None:
        """Take all pairs between a and b out of the collision pairs."""
        self._contact.disable(self._geometries(a, "a"), self._geometries(b, "b"))
        self._built = None

    def enable_pair(self, a: Selector, b: Selector) -> None:
        """Put all pairs between a and b into the collision pairs, also those that the default choice leaves out."""
        self._contact.enable(self._geometries(a, "a"), self._geometries(b, "b"))
        self._built = None

    def _geometries(self, selector: Selector, argument: str) -> list[str]:
        names = self._parts.names
        known = list(names.geometries)
        return [known[index] for index in names.select_geometries(selector, argument)]
