"""Laws of contact of single pairs, beside the two numbers of restitution and friction.

A law is given by settings that each have a default; like the two numbers, each is set for all pairs, for geometries or
for pairs, and a pair uses its own value, else that of its sides, else the default. Pairs without any setting have no
law, and cost nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from contactvi.errors import SceneError
from contactvi.inputs import check_choice, flag, listed, real, short
from contactvi.scene.number_functions import NumberFunction, NumberTable, number_function
from contactvi.scene.pair_rules import Rule, smaller

RESTITUTION_LAWS = ("poisson", "newton", "energetic")
IMPACT_PROCESSES = ("two-phase", "incremental")


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
    """

    restitution_law: str = "poisson"
    impact_process: str = "two-phase"
    limit_energy: bool = True
    tangential_restitution: float = 0.0
    spinning_radius: float = 0.0
    rolling_radius: float = 0.0
    restitution_of_speed: NumberFunction | None = None

    def engine(self, pair: tuple[str, str]) -> dict[str, Any]:
        """Return it as the arguments of the engine; `pair` names it in messages of its functions."""
        e = self.restitution_of_speed
        name = f"the restitution of {pair[0]!r} and {pair[1]!r}"
        return {
            "restitution": RESTITUTION_LAWS.index(self.restitution_law),
            "incremental": self.impact_process == "incremental",
            "keeps_energy": self.limit_energy,
            "tangential": self.tangential_restitution,
            "e": None if e is None else e.engine(name),
            "spinning": self.spinning_radius,
            "rolling": self.rolling_radius,
        }

    def varies(self, kind: str) -> bool:
        """Whether the pair's "restitution" or "friction" depends on a speed, instead of being a number."""
        return kind == "restitution" and self.restitution_of_speed is not None

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
        return ", ".join(
            f"{name.removesuffix('_of_speed')} by the closing speed" if name.endswith("_of_speed") else
            f"{name.replace('_', ' ')} {value}" for name, value in given
        )  # fmt: skip

    @property
    def storable(self) -> bool:
        """Whether it holds no function."""
        return all(getattr(getattr(self, f.name), "storable", True) for f in fields(self))

    def to_data(self) -> dict[str, Any]:
        """Return what is not the default as plain data; functions are left out."""
        plain = {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) != f.default}
        return {
            name: value.to_data() if isinstance(value, NumberTable) else value
            for name, value in plain.items()
            if getattr(value, "storable", True)
        }


DEFAULTS = {f.name: f.default for f in fields(PairLaw)}
# What a scene file says of contacts: the two numbers, the first of which may be a table, and the settings.
CONTACT_SETTINGS = ("restitution", "friction", *(name for name in DEFAULTS if not name.endswith("_of_speed")))


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
        case "spinning_radius" | "rolling_radius":
            return real(name, value, 0.0)
    return real(name, value, 0.0, 1.0)  # tangential_restitution


def checked_contact(
    restitution: Any, friction: Any, varies: bool, **settings: Any
) -> tuple[dict[str, float], dict[str, Any]]:
    """Return the numbers and the settings of laws that are given, checked; None: not given.

    Args:
        varies: whether some restitution depends on the speed, which a number then replaces.

    Raises:
        InputError: one of them is not usable.
    """
    numbers: dict[str, float] = {}
    laws = {name: checked_setting(name, value) for name, value in settings.items() if value is not None}
    if callable(restitution) or np.ndim(restitution) > 0:
        laws["restitution_of_speed"] = number_function("restitution", restitution, 0.0, 1.0)
    elif restitution is not None:
        numbers["restitution"] = real("restitution", restitution, 0.0, 1.0)
        if varies:
            laws["restitution_of_speed"] = None
    if friction is not None:
        numbers["friction"] = real("friction", friction, 0.0)
    return numbers, laws


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
            remedy=f"Set it for the pair: scene.set_contact({a!r}, {b!r}, {self.name.removesuffix('_of_speed')}=...)",
        )


@dataclass
class LawRules:
    """The settings of laws that have been given, each a rule by its name."""

    rules: dict[str, Rule] = field(default_factory=dict)

    def set(self, name: str, first: Sequence[str] | None, second: Sequence[str] | None, value: Any) -> None:
        """Set a setting for all pairs, for geometries (`first`), or between `first` and `second`."""
        self.rules.setdefault(name, Rule(DEFAULTS[name], _Agreed(name))).set(first, second, value)

    def set_from_file(self, name: str, names: Sequence[str], value: Any) -> None:
        """Set the setting that a model's file gives a geometry (one name) or a pair (two)."""
        self.rules.setdefault(name, Rule(DEFAULTS[name], _Agreed(name))).set_from_file(names, value)

    @property
    def vary_restitution(self) -> bool:
        """Whether some restitution depends on the speed."""
        return "restitution_of_speed" in self.rules

    def laws(self, names: Sequence[tuple[str, str]]) -> list[tuple[PairLaw, list[int]]]:
        """Return the laws of pairs of names that have one, each with the places of its pairs."""
        if not self.rules:
            return []
        found: dict[PairLaw, list[int]] = {}
        plain = PairLaw()
        for k, (a, b) in enumerate(names):
            law = PairLaw(**{name: rule.value(a, b) for name, rule in self.rules.items()})
            law.check(a, b)
            if law != plain:
                found.setdefault(law, []).append(k)
        return list(found.items())


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
            if name.endswith("_of_speed"):
                value = NumberTable(*(tuple(map(float, numbers)) for numbers in value))
            else:
                value = checked_setting(name, value)
            for a, b in pairs:
                rules.set(name, [a], [b], value)
    return rules
