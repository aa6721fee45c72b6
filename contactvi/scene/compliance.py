"""Compliant pairs of geometries: a force that is a law of the gap, in place of impacts and rigid contact."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from contactvi.errors import InputError, SceneError
from contactvi.inputs import positive, real, short
from contactvi.scene.contact_functions import DEPTH, NORMAL, RATE, SLIP, ContactFunction, contact_function
from contactvi.scene.pair_rules import Rule

_SAMPLES = np.stack(
    np.meshgrid(np.geomspace(1e-6, 1e-2, 9), [-1.0, -0.1, -0.01, 0.0, 0.02, 0.2, 2.0], indexing="ij"), axis=-1
).reshape(-1, 2)  # depths [m] and their rates [m/s] at which laws are tried
_RUBBING = np.stack(
    np.meshgrid(np.geomspace(1e-3, 1e4, 8), [0.0, 1e-3, 0.03, 0.2, 1.0], indexing="ij"), axis=-1
).reshape(-1, 2)  # normal forces [N] and slips [m/s]
_SHALLOW = 1e-8  # [m] depth at which the power is found with which a law begins
_WHOLE = 1e-3  # by how much a power may miss a whole number


@dataclass(frozen=True)
class Compliance:
    """The law of a compliant pair: f = stiffness d^exponent (1 + damping d'), d the depth [m], d' its rate [m/s].

    With a law of the user, `force`, stiffness and damping are 0, and the exponent is the power with which it begins.

    Attributes:
        stiffness: [N/m^exponent].
        exponent: 1 for a linear spring, 1.5 for Hertz's contact of balls.
        damping: Hunt and Crossley's [s/m].
        friction: Coulomb's coefficient; None: that of the pair.
        slip_speed: [m/s] below which friction is viscous: it is friction f s / sqrt(s^2 + slip_speed^2) at the speed s.
        force: [N] of depth and rate, in the place of f; None: f.
        energy: [J] of the depth, whose slope is the force at rest; None: all that the force does is work.
        bound: [N] on friction, of normal force and slip, in the place of friction f; None: that.
    """

    stiffness: float
    exponent: float = 1.0
    damping: float = 0.0
    friction: float | None = None
    slip_speed: float = 1e-3
    force: ContactFunction | None = None
    energy: ContactFunction | None = None
    bound: ContactFunction | None = None

    @classmethod
    def checked(
        cls, stiffness: Any, exponent: Any = None, damping: Any = 0.0, friction: Any = None, slip_speed: Any = 1e-3,
        law: Any = None, derivatives: Any = None, potential: Any = None, friction_bound: Any = None,
    ) -> Compliance:  # fmt: skip
        """Return the law with these numbers and functions, which are tried; raises InputError, UserFunctionError."""
        rubs = None if friction is None else real("friction", friction, 0.0)
        slow = positive("slip_speed", slip_speed, "a number > 0 m/s")
        bound = None
        if friction_bound is not None:
            if friction is not None:
                raise _misplaced("friction", friction, "None with friction_bound=, which is the whole friction")
            name = "the bound on the friction of a compliance"
            bound = contact_function(
                "friction_bound", name, (NORMAL, SLIP), friction_bound, None, "the friction [N]", pushes=True
            )
            bound.check("friction_bound", _RUBBING)
            rubs = 0.0
        if law is None:
            for name, value in (("derivatives", derivatives), ("potential", potential)):
                if value is not None:
                    raise _misplaced(name, value, "None without law=")
            return cls(
                positive("stiffness", stiffness, "a number > 0 N/m^exponent, or None for a rigid pair"),
                1.0 if exponent is None else real("exponent", exponent, 1.0, 10.0),
                real("damping", damping, 0.0), rubs, slow, bound=bound,
            )  # fmt: skip
        for name, value in (("stiffness", stiffness), ("damping", damping or None)):
            if value is not None:
                raise _misplaced(name, value, "None with law=, which is the whole normal force")
        force = contact_function("law", "the law of a compliance", (DEPTH, RATE), law, derivatives, "the force [N]")
        energy = None
        if potential is not None:
            energy = contact_function(
                "potential", "the potential of a compliance", (DEPTH,), potential, None, "the energy [J]"
            )
        power = _checked_force(force, energy)
        given = power if exponent is None else real("exponent", exponent, 1.0, 10.0)
        return cls(0.0, given, 0.0, rubs, slow, force, energy, bound)

    @property
    def dissipates(self) -> bool:
        """Whether it does work beside that of a potential."""
        return bool(self.damping or self.friction or self.force or self.bound)

    @property
    def storable(self) -> bool:
        """Whether it holds no function."""
        return self.force is None and self.bound is None

    def describe(self) -> str:
        """Return the law in words."""
        rubs = f", Coulomb friction {self.friction:g} above {self.slip_speed:g} m/s" if self.friction else ""
        if self.bound is not None:
            rubs = ", friction by a function of the normal force and the slip"
        if self.force is not None:
            energy = "with a potential" if self.energy is not None else "all of it work"
            return f"force by a function of the depth and its rate, {energy}{rubs}"
        law = f"k d^{self.exponent:g}" if self.exponent != 1.0 else "k d"
        unit = "N/m" if self.exponent == 1.0 else f"N/m^{self.exponent:g}"
        damped = f", damping {self.damping:g} s/m" if self.damping else ""
        return f"force {law}, k = {self.stiffness:g} {unit}{damped}{rubs}"

    def to_data(self) -> dict[str, float | bool | None]:
        """Return the numbers by name, `from_data` takes them; of functions whether they were there."""
        numbers = ("stiffness", "exponent", "damping", "friction", "slip_speed")
        lost = {name: True for name in _FUNCTIONS if getattr(self, name) is not None}
        return {name: getattr(self, name) for name in numbers} | lost

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Compliance:
        """Return the law that `to_data` described, without its functions."""
        numbers = {name: value for name, value in data.items() if name not in _FUNCTIONS}
        plain = cls.checked(**(numbers | ({"stiffness": 1.0} if data.get("force") else {})))
        lost: dict[str, Any] = {
            name: ContactFunction(f"the {name} of a compliance", known, None, None, "")
            for name, known in _FUNCTIONS.items()
            if data.get(name)
        }
        return replace(plain, stiffness=numbers["stiffness"], **lost)


# Of a law, by the names of its attributes, what they are functions of.
_FUNCTIONS = {"force": (DEPTH, RATE), "energy": (DEPTH,), "bound": (NORMAL, SLIP)}


def _misplaced(name: str, value: Any, expected: str) -> InputError:
    return InputError(
        f"The compliance has {name} where it takes none", name=name, expected=expected, got=short(value),
        remedy=f"Leave {name} out",
    )  # fmt: skip


def _checked_force(force: ContactFunction, energy: ContactFunction | None) -> float:
    """Try the functions; return the power of the depth with which the force begins.

    Raises:
        UserFunctionError, InputError: as `ContactFunction.check`; a force that pulls at rest, or rises with a slope
            without bounds; an energy of which it is not the slope.
    """
    force.check("law", _SAMPLES)
    still = _SAMPLES * (1.0, 0.0)
    at_rest = force.values(still)
    if np.any(at_rest < 0.0):
        k = int(np.argmin(at_rest))
        raise InputError(
            "The law of a compliance pulls at rest", name="law",
            expected="a force >= 0 N at the rate 0: a contact that pulls opens", got=f"{at_rest[k]:g} N at "
            f"{still[k, 0]:g} m", remedy="Let it push, or pull with scene.add_force",
        )  # fmt: skip
    if energy is not None:
        energy.check("potential", still)
        slopes = energy.slopes(still)[:, 0]
        off = np.abs(slopes - at_rest) / (np.abs(at_rest) + np.finfo(float).tiny)
        if np.median(off) > 1e-5:
            k = int(np.argsort(off)[len(off) // 2])
            raise InputError(
                "The law at rest is not the slope of its potential", name="potential",
                expected=f"the slope {at_rest[k]:.9g} N at {still[k, 0]:g} m, which is the law at the rate 0",
                got=f"{slopes[k]:.9g} N, by differences", remedy="Correct it, or leave it out: the force is then work",
            )  # fmt: skip
    low, high = np.diff(force.values(np.array([[0.0, 0.0], [_SHALLOW, 0.0], [2.0 * _SHALLOW, 0.0]])))
    if not low > 0.0:
        return 1.0
    power = float(np.log2(1.0 + high / low))
    if power < 1.0 - 10.0 * _WHOLE:
        raise InputError(
            "The law of a compliance begins with a slope without bounds", name="law",
            expected="a force that grows with the depth, or a higher power of it, from the opening on",
            got=f"one that grows with its power {power:.3g}", remedy="Correct the law near depth 0",
        )  # fmt: skip
    whole = round(power)
    return float(whole) if abs(power - whole) < _WHOLE else min(power, 10.0)


@dataclass(frozen=True)
class ComplianceRow:
    """A compliant pair as the engine takes it: numbers and names of its geometries, and a law with a friction."""

    a: int
    b: int
    names: tuple[str, str]
    law: Compliance


def softer(laws: list[Compliance | None], names: tuple[str, str]) -> Compliance | None:
    """Return the law of the softer one of two sides; None: both are rigid. Raises SceneError for functions."""
    given = [law for law in laws if law is not None]
    if len(given) == 2 and given[0] is not given[1] and not all(law.storable for law in given):
        raise SceneError(
            f"Of the compliances of {names[0]!r} and {names[1]!r} none is the softer one",
            expected="one law, where one is a function", got="a law of its own of each side",
            remedy=f"Set it for the pair: scene.set_compliance({names[0]!r}, {names[1]!r}, ...)",
        )  # fmt: skip
    return min(given, key=lambda law: law.stiffness, default=None)


@dataclass
class ComplianceRule(Rule):
    """Which pairs of geometries are compliant: those set as pairs; else those of which a side is, by the softer side.

    The values are laws; None: rigid.
    """

    default: Compliance | None = None
    combine: Callable[[list[Any], tuple[str, str]], Any] = softer

    def mask(self, names: Sequence[str]) -> np.ndarray | None:
        """Return which pairs of these geometries are compliant, shape (n, n), above the diagonal; None: none is."""
        soft = np.array([self.single.get(name) is not None for name in names], dtype=bool)
        if not soft.any() and not any(law is not None for law in self.pair.values()):
            return None
        found = soft[:, None] | soft[None, :]
        index = {name: k for k, name in enumerate(names)}
        for (a, b), law in self.pair.items():
            if a in index and b in index:
                found[index[a], index[b]] = found[index[b], index[a]] = law is not None
        return np.asarray(np.triu(found, 1))


def compliance_rows(
    rule: ComplianceRule, names: Sequence[str], pairs: np.ndarray, friction: np.ndarray
) -> list[ComplianceRow]:
    """Return the laws of compliant pairs (n, 2), with the friction of the pairs (n,) where they give none."""
    rows = []
    for (a, b), mu in zip(pairs.tolist(), friction, strict=True):
        law = rule.value(names[a], names[b])
        assert law is not None
        own = float(mu) if law.friction is None else law.friction
        rows.append(ComplianceRow(a, b, (names[a], names[b]), replace(law, friction=own)))
    return rows


def compliance_name(pair: tuple[str, str]) -> str:
    """Return the name of the law of a compliant pair in the list of what is missing."""
    return f"compliance of {pair[0]} and {pair[1]}"


def compliances_to_dict(rows: Sequence[ComplianceRow]) -> list[dict[str, Any]]:
    """Return compliant pairs as plain data."""
    return [{"pair": list(row.names), **row.law.to_data()} for row in rows]


def compliances_from_dict(data: Sequence[Mapping[str, Any]]) -> ComplianceRule:
    """Return the rule that `compliances_to_dict` described."""
    rule = ComplianceRule()
    for row in data:
        a, b = map(str, row["pair"])
        rule.set([a], [b], Compliance.from_data({key: value for key, value in row.items() if key != "pair"}))
    return rule
