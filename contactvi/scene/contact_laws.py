"""Laws of contact of single pairs, beside the two numbers of restitution and friction.

A law is given by settings that each have a default; like the two numbers, each is set for all pairs, for geometries or
for pairs, and a pair uses its own value, else that of its sides, else the default. Pairs without any setting have no
law, and cost nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from contactvi.errors import InputError, SceneError
from contactvi.inputs import check_choice, flag, listed, positive, real, short, vector
from contactvi.scene.body_adhesion import BodyAdhesion, adhesive_bodies
from contactvi.scene.contact_functions import CLOSING, NORMAL, SLIP, TIME, ContactFunction, state_law
from contactvi.scene.number_functions import NumberFunction, NumberTable, number_function
from contactvi.scene.pair_rules import Rule, smaller

RESTITUTION_LAWS = ("poisson", "newton", "energetic")
IMPACT_PROCESSES = ("two-phase", "incremental")
_SLIPS, _TIMES = (0.0, 1e-3, 0.03, 0.2, 1.0), (0.0, 0.3)


def _samples(*numbers: Any) -> np.ndarray:
    return np.stack(np.meshgrid(*numbers, indexing="ij"), axis=-1).reshape(-1, len(numbers))


_IMPACTS = _samples((1e-3, 0.1, 1.0, 5.0), _SLIPS, _TIMES)  # closing speeds, slips [m/s] and times [s] to try laws at
_LOADS = _samples(_SLIPS, (1e-3, 1e-1, 1.0, 1e2, 1e4, np.inf), _TIMES)  # slips, normal forces [N] and times


@dataclass(frozen=True)
class FrictionAxis:
    """Friction that depends on its direction: an axis of a surface, and the coefficients along it and across it.

    Attributes:
        geometry: in whose frame the axis is.
        axis: (3,), unit; of a contact its part in the tangent plane counts.
        along, across: Coulomb's coefficients, > 0; the friction of a direction is that of the ellipse with these.
    """

    geometry: str
    axis: tuple[float, ...]
    along: float
    across: float
    storable = True

    @property
    def shares(self) -> tuple[float, float]:
        """The coefficients as shares of the larger one."""
        largest = max(self.along, self.across)
        return self.along / largest, self.across / largest

    def to_data(self) -> Any:
        """Return it as plain data."""
        return [self.geometry, list(self.axis), self.along, self.across]


@dataclass(frozen=True)
class PairLaw:
    """The law of a pair.

    Attributes:
        restitution_law: what the coefficient of restitution is the ratio of: "poisson" impulses, "newton" speeds,
            "energetic" roots of works.
        impact_process: "two-phase", or "incremental": an impact of one point is followed through its impulse.
        limit_energy: whether restitution is lowered where it would make energy.
        tangential_restitution: of the slip, where friction holds it, in [0, 1].
        spinning_radius: [m] of the friction of a point against spinning about its normal; 0: none.
        rolling_radius: [m] of that against rolling.
        restitution_of_speed: coefficient by the closing speed, instead of the pair's number.
        restitution_of_state: coefficient by the closing speed, the slip before and the time, instead of it.
        static_friction: coefficient of what sticks; None: as of what slides.
        friction_of_speed: coefficient by the speed of the slip, instead of the pair's number.
        friction_of_state: coefficient by the speed of the slip, the normal force and the time, instead of it.
        friction_axis: of friction that depends on its direction.
        adhesion: pull up to which the surfaces stay together [N].
        adhesion_of_time: that pull by the time, instead of the number.
        adhesive: the pulls of its bodies on all that they touch, besides.
    """

    restitution_law: str = "poisson"
    impact_process: str = "two-phase"
    limit_energy: bool = True
    tangential_restitution: float = 0.0
    spinning_radius: float = 0.0
    rolling_radius: float = 0.0
    restitution_of_speed: NumberFunction | None = None
    restitution_of_state: ContactFunction | None = None
    static_friction: float | None = None
    friction_of_speed: NumberFunction | None = None
    friction_of_state: ContactFunction | None = None
    friction_axis: FrictionAxis | None = None
    adhesion: float = 0.0
    adhesion_of_time: NumberFunction | None = None
    adhesive: tuple[BodyAdhesion, ...] = ()

    def engine(self, pair: tuple[str, str], added: Callable[[ContactFunction], int]) -> dict[str, Any]:
        """Return it as the arguments of the engine.

        Args:
            pair: names it in messages of its functions.
            added: hands a function of the state of a contact to the engine, and returns its number.
        """

        def of(function: NumberFunction | None, what: str) -> Any:
            return None if function is None else function.engine(f"the {what} of {pair[0]!r} and {pair[1]!r}")

        pull = self.adhesion_of_time
        if pull is None and self.adhesion:
            pull = NumberTable((0.0,), (self.adhesion,))
        axis = self.friction_axis
        return {
            "restitution": RESTITUTION_LAWS.index(self.restitution_law),
            "incremental": self.impact_process == "incremental",
            "keeps_energy": self.limit_energy,
            "tangential": self.tangential_restitution,
            "e": of(self.restitution_of_speed, "restitution"),
            "e_of_state": self.restitution_of_state and added(self.restitution_of_state),
            "mu": of(self.friction_of_speed, "friction"),
            "mu_of_state": self.friction_of_state and added(self.friction_of_state),
            "static_mu": self.static_friction,
            "pull": of(pull, "adhesion"),
            "axis_of": -1 if axis is None else pair.index(axis.geometry),
            "axis": np.zeros(3) if axis is None else np.array(axis.axis),
            "shares": np.ones(2) if axis is None else np.array(axis.shares),
            "spinning": self.spinning_radius,
            "rolling": self.rolling_radius,
        }

    def varies(self, kind: str) -> bool:
        """Whether the pair's "restitution" or "friction" depends on a speed, instead of being a number."""
        if kind != "restitution":
            return self.rubs
        return self.restitution_of_speed is not None or self.restitution_of_state is not None

    @property
    def rubs(self) -> bool:
        """Whether its friction is not Coulomb's with one number."""
        laws = (self.static_friction, self.friction_of_speed, self.friction_of_state, self.friction_axis)
        return any(law is not None for law in laws)

    @property
    def adheres(self) -> bool:
        """Whether its surfaces pull at each other."""
        return self.adhesion > 0.0 or self.adhesion_of_time is not None or bool(self.adhesive)

    def pull(self, t: float) -> float:
        """Return the adhesion of the pair by itself at a time [s] in N."""
        given = self.adhesion_of_time
        return self.adhesion if given is None else given.at(t, "a law of adhesion")

    @property
    def followed(self) -> bool:
        """Whether impacts of one point are followed through their impulse."""
        return self.impact_process == "incremental" or self.restitution_law == "energetic"

    @property
    def turning(self) -> bool:
        """Whether there is friction against spinning or rolling."""
        return self.spinning_radius > 0.0 or self.rolling_radius > 0.0

    def check(self, a: str, b: str) -> None:
        """Raise SceneError where the settings of the pair of a and b do not go together."""
        if self.tangential_restitution > 0.0 and self.followed:
            raise SceneError(
                f"The impact of {a!r} and {b!r} is followed, and has no tangential restitution",
                expected="impact_process='two-phase', restitution_law='poisson' or 'newton'",
                got=f"{self.impact_process!r}, {self.restitution_law!r}",
                remedy=f"scene.set_contact({a!r}, {b!r}, tangential_restitution=0), or the other process and law",
            )
        if self.turning and (self.followed or self.tangential_restitution > 0.0):
            raise SceneError(
                f"The contact of {a!r} and {b!r} has friction against spinning or rolling, with which this law of "
                "restitution is not known",
                expected="impact_process='two-phase', restitution_law='poisson' or 'newton', tangential_restitution=0",
                got=self.words(),
                remedy=f"scene.set_contact({a!r}, {b!r}, spinning_radius=0, rolling_radius=0), or the other process "
                "and law",
            )

    def words(self) -> str:
        """Return what is not the default as text."""
        given = [(f.name, getattr(self, f.name)) for f in fields(self) if getattr(self, f.name) != f.default]
        return ", ".join(_words(name, value) for name, value in given)

    @property
    def storable(self) -> bool:
        """Whether it holds no function."""
        single = all(getattr(getattr(self, f.name), "storable", True) for f in fields(self))
        return single and all(adhesion.storable for adhesion in self.adhesive)

    def to_data(self) -> dict[str, Any]:
        """Return what is not the default as plain data; functions are left out."""
        plain = {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) != f.default}
        stored = {
            name: value.to_data() if isinstance(value, NumberTable | FrictionAxis) else value
            for name, value in plain.items()
            if getattr(value, "storable", True)
        }
        if self.adhesive:
            stored["adhesive"] = [adhesion.to_data() for adhesion in self.adhesive if adhesion.storable]
        return stored


def _argument(name: str) -> str:
    """Return the argument of `Scene.set_contact` that gives a setting."""
    return name.removesuffix("_of_speed").removesuffix("_of_time")


def _words(name: str, value: Any) -> str:
    """Return a setting that is not the default in words."""
    if isinstance(value, FrictionAxis):
        axis = ", ".join(f"{x:g}" for x in value.axis)
        return f"friction {value.along:g} along ({axis}) of {value.geometry!r} and {value.across:g} across"
    if name == "adhesive":
        return ", ".join(adhesion.name.removeprefix("the ") for adhesion in value)
    speed = "the closing speed" if name.startswith("restitution") else "the speed of the slip"
    state = "the closing speed, the slip and the time"
    if not name.startswith("restitution"):
        state = "the slip, the normal force and the time"
    for ending, of in (("_of_speed", speed), ("_of_time", "the time"), ("_of_state", state)):
        if name.endswith(ending):
            return f"{name.removesuffix(ending)} by {of}"
    return f"{name.replace('_', ' ')} {value}"


DEFAULTS = {f.name: f.default for f in fields(PairLaw)}
# What a scene file says of contacts: the two numbers, the first of which may be a table, and the settings.
CONTACT_SETTINGS = (
    "restitution",
    "friction",
    *(name for name in DEFAULTS if not name.endswith(("_of_speed", "_of_time", "_of_state")) and name != "adhesive"),
)


def checked_setting(name: str, value: Any) -> Any:
    """Return a checked setting of a law; raises InputError."""
    match name:
        case "restitution_law":
            check_choice(name, value, RESTITUTION_LAWS, "law of restitution")
            return value
        case "impact_process":
            check_choice(name, value, IMPACT_PROCESSES, "process of an impact")
            return value
        case "limit_energy":
            return flag(name, value)
        case "static_friction" | "adhesion" | "spinning_radius" | "rolling_radius":
            return real(name, value, 0.0)
    return real(name, value, 0.0, 1.0)  # tangential_restitution


def _is_function(value: Any, dimensions: int) -> bool:
    """Whether a coefficient is a function or a table, which has these dimensions at least."""
    return callable(value) or np.ndim(value) >= dimensions


def checked_contact(
    rules: LawRules, first: Sequence[str] | None, restitution: Any, friction: Any, friction_axis: Any, adhesion: Any,
    restitution_of_state: Any, friction_of_state: Any, **settings: Any,
) -> tuple[dict[str, float], dict[str, Any]]:  # fmt: skip
    """Return the numbers and the settings of laws that are given, checked; None: not given.

    Args:
        rules: those so far: a number replaces a function that was given for it.
        first: the geometries that were named first.

    Raises:
        InputError: one of them is not usable.
    """
    numbers: dict[str, float] = {}
    laws = {name: checked_setting(name, value) for name, value in settings.items() if value is not None}
    if _is_function(restitution, 1):
        laws["restitution_of_speed"] = number_function("restitution", restitution, 0.0, 1.0)
    elif restitution is not None:
        numbers["restitution"] = real("restitution", restitution, 0.0, 1.0)
        if "restitution_of_speed" in rules.rules:
            laws["restitution_of_speed"] = None
    if restitution_of_state is not None:
        if restitution is not None:
            raise InputError(
                "Restitution is given twice", name="restitution_of_state", expected="one of restitution and "
                "restitution_of_state", got="both", remedy="Leave one of them out",
            )  # fmt: skip
        laws["restitution_of_state"] = state_law(
            "restitution_of_state", "the law of restitution", (CLOSING, SLIP, TIME), restitution_of_state,
            "the coefficient", 1.0, _IMPACTS, "restitution_of_state=lambda closing, slip, t: 0.8 / (1 + slip)",
        )  # fmt: skip
        if "restitution_of_speed" in rules.rules:
            laws["restitution_of_speed"] = None
    elif restitution is not None and "restitution_of_state" in rules.rules:
        laws["restitution_of_state"] = None
    replaced: tuple[str, ...] = ()
    if friction_of_state is not None:
        for name, other in (("friction", friction), ("static_friction", settings.get("static_friction"))):
            if other is not None:
                raise InputError(
                    "Friction is given twice", name="friction_of_state", expected=f"no {name} beside friction_of_state",
                    got=f"{name}={short(other)}", remedy="Leave one of them out: the law holds for what sticks, too",
                )  # fmt: skip
        laws["friction_of_state"] = state_law(
            "friction_of_state", "the law of friction", (SLIP, NORMAL, TIME), friction_of_state, "the coefficient",
            np.inf, _LOADS, "friction_of_state=lambda slip, normal, t: 0.5 / (1 + normal / 100)",
        )  # fmt: skip
        replaced = ("friction_of_speed", "friction_axis", "static_friction")
    elif np.ndim(friction) == 1 or friction_axis is not None:
        laws["friction_axis"] = _friction_axis(first, friction, friction_axis)
        numbers["friction"] = max(laws["friction_axis"].along, laws["friction_axis"].across)
        replaced = ("friction_of_speed", "friction_of_state")
    elif _is_function(friction, 2):
        laws["friction_of_speed"] = number_function("friction", friction, 0.0, np.inf)
        replaced = ("friction_axis", "friction_of_state")
    elif friction is not None:
        numbers["friction"] = real("friction", friction, 0.0)
        replaced = ("friction_of_speed", "friction_of_state", "friction_axis", "static_friction")
    laws |= {name: None for name in replaced if name in rules.rules and name not in laws}
    if _is_function(adhesion, 1):
        laws["adhesion_of_time"] = number_function("adhesion", adhesion, 0.0, np.inf, "s")
    elif adhesion is not None:
        laws["adhesion"] = real("adhesion", adhesion, 0.0)
        if "adhesion_of_time" in rules.rules:
            laws["adhesion_of_time"] = None
    return numbers, laws


def _friction_axis(first: Sequence[str] | None, friction: Any, axis: Any) -> FrictionAxis:
    """Return the checked axis of the one geometry that is named first."""
    expected = "friction=(along, across) of two numbers > 0 with friction_axis=(x, y, z), for one geometry named first"
    if axis is None or np.shape(friction) != (2,) or first is None or len(first) != 1:
        named = "none" if first is None else ", ".join(map(repr, first))
        raise InputError(
            "Friction that depends on its direction is incomplete", name="friction_axis", expected=expected,
            got=f"friction={short(friction)}, friction_axis={short(axis)}, of {named}",
            remedy="For example set_contact('table', friction=(0.2, 0.6), friction_axis=(1, 0, 0))",
        )  # fmt: skip
    along, across = (positive("friction", float(mu), "two numbers > 0") for mu in friction)
    direction = vector("friction_axis", axis, 3)
    size = positive("friction_axis", float(np.linalg.norm(direction)), "a direction that is not zero")
    return FrictionAxis(first[0], tuple(float(x) for x in direction / size), along, across)


@dataclass(frozen=True)
class _Agreed:
    """What two sides of a pair make of a setting: the smaller one of two numbers; all else has to agree."""

    name: str

    def __call__(self, values: list[Any], names: tuple[str, str]) -> Any:
        if all(value == values[0] for value in values):
            return values[0]
        if all(isinstance(value, float) for value in values):
            return smaller(values, names)
        a, b = names
        raise SceneError(
            f"The two sides of a contact have different values of {self.name}",
            expected="one value for the pair",
            got=f"{short(values[0])} of {a!r}, {short(values[1])} of {b!r}",
            remedy=f"Set it for the pair: scene.set_contact({a!r}, {b!r}, {_argument(self.name)}=...)",
        )


@dataclass
class LawRules:
    """The settings of laws that have been given, each a rule by its name.

    Attributes:
        bodies: adhesion of bodies, with the names of their geometries.
    """

    rules: dict[str, Rule] = field(default_factory=dict)
    bodies: list[tuple[frozenset[str], BodyAdhesion]] = field(default_factory=list)

    def set(self, name: str, first: Sequence[str] | None, second: Sequence[str] | None, value: Any) -> None:
        """Set a setting for all pairs, for geometries (`first`), or between `first` and `second`."""
        self.rule(name).set(first, second, value)

    def rule(self, name: str) -> Rule:
        """Return the rule of a setting."""
        return self.rules.setdefault(name, Rule(DEFAULTS[name], _Agreed(name)))

    def laws(self, names: Sequence[tuple[str, str]]) -> list[tuple[PairLaw, list[int]]]:
        """Return the laws of pairs of names that have one, each with the places of its pairs."""
        if not self.rules and not self.bodies:
            return []
        found: dict[PairLaw, list[int]] = {}
        plain = PairLaw()
        for k, (a, b) in enumerate(names):
            law = PairLaw(**{name: rule.value(a, b) for name, rule in self.rules.items()})
            if adhesive := adhesive_bodies(self.bodies, a, b):
                law = replace(law, adhesive=adhesive)
            law.check(a, b)
            if law != plain:
                found.setdefault(law, []).append(k)
        return list(found.items())


def check_restitution(law: PairLaw, friction: np.ndarray, pair: tuple[str, str]) -> None:
    """Raise SceneError where restitution depends on a slip that is not known, or on two things."""
    if law.restitution_of_state is None or (law.restitution_of_speed is None and float(np.min(friction)) > 0.0):
        return
    both = law.restitution_of_speed is not None
    raise SceneError(
        f"The restitution of {pair[0]!r} and {pair[1]!r} is not usable",
        expected="one law of restitution" if both else "friction > 0, with which the slip of an impact is found",
        got="a function of the speed of one side, one of the state of the other" if both else "friction 0",
        remedy=f"scene.set_contact({pair[0]!r}, {pair[1]!r}, " + ("restitution=...)" if both else "friction=...)"),
    )  # fmt: skip


def check_friction(law: PairLaw, friction: np.ndarray, pair: tuple[str, str]) -> None:
    """Raise SceneError where a pair with a law of friction has none where it begins to slide, or less at rest."""
    if law.turning and law.rubs:
        raise SceneError(
            f"The contact of {pair[0]!r} and {pair[1]!r} has friction against spinning or rolling beside another law",
            expected="one coefficient of friction", got="friction by the slip, by its direction or at rest",
            remedy=f"scene.set_contact({pair[0]!r}, {pair[1]!r}, friction=...), or spinning_radius=0, rolling_radius=0",
        )  # fmt: skip
    if not law.rubs:
        return
    if law.friction_of_state is not None:
        others = ("friction_of_speed", "friction_axis", "static_friction")
        given = [name for name in others if getattr(law, name) is not None]
        if given:
            raise SceneError(
                f"The friction of {pair[0]!r} and {pair[1]!r} has two laws", expected="friction_of_state alone",
                got=f"friction_of_state of one side, {given[0].replace('_', ' ')} of the other",
                remedy=f"Set it for the pair: scene.set_contact({pair[0]!r}, {pair[1]!r}, friction_of_state=...)",
            )  # fmt: skip
        return
    if law.friction_axis is not None and law.friction_of_speed is not None:
        raise SceneError(
            f"The friction of {pair[0]!r} and {pair[1]!r} depends on the direction and on the speed of the slip",
            expected="one of both", got="friction_axis of one side, a table or function of the other",
            remedy=f"Set it for the pair: scene.set_contact({pair[0]!r}, {pair[1]!r}, friction=...)",
        )  # fmt: skip
    least, rest = float(np.min(friction)), law.static_friction
    if least > 0.0 and (rest is None or rest >= float(np.max(friction))):
        return
    raise SceneError(
        f"The friction of {pair[0]!r} and {pair[1]!r} is not usable",
        expected="friction > 0 where a slip begins, and static_friction of at least that",
        got=f"friction {least:g}" + ("" if rest is None else f", static_friction {rest:g}"),
        remedy=f"scene.set_contact({pair[0]!r}, {pair[1]!r}, friction=..., static_friction=...)",
    )


def laws_to_data(laws: Sequence[tuple[PairLaw, Sequence[int]]], names: Sequence[tuple[str, str]]) -> list[Any]:
    """Return laws as plain data: each with the names of its pairs."""
    return [{"pairs": [list(names[k]) for k in places], **law.to_data()} for law, places in laws]


def laws_from_data(rows: Sequence[Mapping[str, Any]]) -> LawRules:
    """Return the rules of stored laws."""
    rules = LawRules()
    for row in rows:
        pairs = [tuple(pair) for pair in listed("pairs", row["pairs"], "pairs of names")]
        for name, value in row.items():
            if name == "pairs":
                continue
            if name == "friction_axis":
                value = FrictionAxis(str(value[0]), tuple(map(float, value[1])), float(value[2]), float(value[3]))
            elif name == "adhesive":
                value = tuple(map(BodyAdhesion.from_data, value))
            elif name.endswith(("_of_speed", "_of_time")):
                value = NumberTable(*(tuple(map(float, numbers)) for numbers in value))
            else:
                value = checked_setting(name, value)
            for a, b in pairs:
                rules.set(name, [a], [b], value)
    return rules
