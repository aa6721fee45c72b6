"""The exceptions of contactvi: one root, few children, the data kept as fields.

Every error gives what was expected, what was got and how to remedy it: all three are needed to make one.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, TypedDict

if TYPE_CHECKING:
    from typing_extensions import Unpack


class _Texts(TypedDict):
    """What every error is made with."""

    expected: object
    got: object
    remedy: str


class _Place(_Texts, total=False):
    """And where a file or a model is wrong."""

    path: object | None
    joint: str | None
    body: str | None


class ContactviError(Exception):
    """Root of every error raised on purpose by contactvi.

    Args:
        what: the fact, one sentence without a full stop.
        expected, got, remedy: short texts, kept as fields and joined into the message ``what: expected ..., got ....
            Remedy.`` The remedy says what to do next.
    """

    def __init__(
        self,
        what: str,
        *,
        expected: object,
        got: object,
        remedy: str,
    ) -> None:
        self.what = what
        self.expected = expected
        self.got = got
        self.remedy = remedy
        super().__init__(self._message())

    def _message(self) -> str:
        end = (
            "" if self.remedy.endswith((".", "?", "!")) or "\n" in self.remedy else "."
        )  # lines of a file stay as they are
        return f"{self.what.rstrip('.')}: expected {self.expected}, got {self.got}. {self.remedy}{end}"

    def put_in(self, place: str) -> None:
        """Put in front of the fact where it is, for example "Run 3 of the batch"."""
        self.what = f"{place}: {self.what}"
        self.args = (self._message(),)

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (type(self), self.args, self.__dict__)


def _restored(kind: type[ContactviError], args: tuple[Any, ...], fields: dict[str, Any]) -> ContactviError:
    """Return a copy of an error, for pickle and copy: what it was made with is not kept as such."""
    error = kind.__new__(kind, *args)
    error.__dict__.update(fields)
    return error


def missing_package(package: str, extra: str) -> ContactviError:
    """Return the error for a package that is not installed, which an extra of contactvi brings."""
    return ContactviError(
        f"{package} is not installed", expected=f"the package {extra}", got="none",
        remedy=f'pip install "contactvi[{extra}]"',
    )  # fmt: skip


class InputError(ContactviError, ValueError):
    """A bad argument: wrong shape, wrong range, not finite, unknown option. `name` is the argument."""

    def __init__(self, what: str, *, name: str | None = None, **texts: Unpack[_Texts]) -> None:
        self.name = name
        super().__init__(what, **texts)


class OverwriteError(InputError):
    """A file that is there already and would be replaced. `path` is the file."""

    def __init__(self, what: str, *, path: object | None = None, **texts: Unpack[_Texts]) -> None:
        self.path = None if path is None else str(path)
        super().__init__(what, name="path", **texts)


class SceneError(ContactviError):
    """A file or a model that cannot be used. `path`, `joint` and `body` tell where, when known.

    `report` is what was found in the model until then (contactvi.importing.report.PartReport), during an import.
    """

    def __init__(
        self,
        what: str,
        *,
        path: object | None = None,
        joint: str | None = None,
        body: str | None = None,
        **texts: Unpack[_Texts],
    ) -> None:
        self.path = None if path is None else str(path)
        self.joint = joint
        self.body = body
        self.report: Any = None
        super().__init__(what, **texts)


class UnsupportedJointError(SceneError):
    """A joint type that the engine refuses; `joint` is its name, `joint_type` its Pinocchio type."""

    def __init__(
        self,
        what: str,
        *,
        joint_type: str | None = None,
        **place: Unpack[_Place],
    ) -> None:
        self.joint_type = joint_type
        super().__init__(what, **place)


class PenetrationError(ContactviError):
    """A start in penetration: `pair` (names), `depth` [m] > 0."""

    def __init__(
        self,
        what: str,
        *,
        pair: tuple[str, str] | None = None,
        depth: float | None = None,
        **texts: Unpack[_Texts],
    ) -> None:
        self.pair = pair
        self.depth = depth
        super().__init__(what, **texts)


class SeparationError(PenetrationError):
    """Overlaps of a start that cannot be ended, or only by moving bodies too far.

    `pair`, `depth`: of the deepest one. `moves`: how far the bodies would be moved (`Separation.moves`), empty where no
    way out was found.
    """

    def __init__(
        self,
        what: str,
        *,
        pair: tuple[str, str] | None = None,
        depth: float | None = None,
        moves: tuple[Any, ...] = (),
        **texts: Unpack[_Texts],
    ) -> None:
        self.moves = moves
        super().__init__(what, pair=pair, depth=depth, **texts)


class ConstraintError(ContactviError):
    """Constraints that are not met, or cannot be.

    `residuals`: name -> largest residual [m, rad; m/s, rad/s], worst first. `status`, `trajectory`: the end of a run
    that could not meet them, and the part of it that was computed.
    """

    def __init__(
        self,
        what: str,
        *,
        residuals: Mapping[str, float] | None = None,
        status: Any = None,
        trajectory: Any = None,
        **texts: Unpack[_Texts],
    ) -> None:
        self.residuals = dict(residuals or {})
        self.status = status
        self.trajectory = trajectory
        super().__init__(what, **texts)

    @property
    def constraints(self) -> tuple[str, ...]:
        """Names of the constraints, worst first."""
        return tuple(self.residuals)


class UserFunctionError(InputError):
    """A function of the user that fails or returns what cannot be used.

    `function` is its name, `time` when it was called [s] (None: it is no function of time), `entry` which of the
    numbers it returned is wrong. What it raised is the error's `__cause__`.
    """

    def __init__(
        self,
        what: str,
        *,
        function: str | None = None,
        time: float | None = None,
        entry: str | None = None,
        **texts: Unpack[_Texts],
    ) -> None:
        self.function = function
        self.time = time
        self.entry = entry
        super().__init__(what, name=function, **texts)


class DerivativeError(InputError):
    """A derivative given by the user that is not that of the function.

    `function` is the derivative's name, `row` and `column` the wrong entry (None: there is none such), `dof` the names
    of the joints these belong to, `error` the difference from central differences.
    """

    def __init__(
        self,
        what: str,
        *,
        function: str | None = None,
        row: int | None = None,
        column: int | None = None,
        dof: tuple[str, ...] = (),
        error: float | None = None,
        **texts: Unpack[_Texts],
    ) -> None:
        self.function = function
        self.row, self.column = row, column
        self.dof = dof
        self.error = error
        super().__init__(what, name=function, **texts)


class SimulationError(ContactviError):
    """A run that ended before its time. `status` tells why, `trajectory` is the part that was computed."""

    def __init__(
        self,
        what: str,
        *,
        status: Any = None,
        trajectory: Any = None,
        **texts: Unpack[_Texts],
    ) -> None:
        self.status = status
        self.trajectory = trajectory
        super().__init__(what, **texts)


class EngineError(ContactviError, RuntimeError):
    """What the engine itself refuses, or a fault inside of it. It is made by the compiled module."""

    def __init__(self, what: str, expected: str, got: str, remedy: str) -> None:
        super().__init__(what, expected=expected, got=got, remedy=remedy)


class NotDifferentiable(ContactviError):
    """A step, an impact or a contact that has no derivative, or none that is known.

    Where known, `pair` (names) and `time` [s] tell where, and `reason` is one of

    - of a step: "impact", "contact", "saturation" of an actuator, "step" whose equations were not solved, or that is
      made in parts; of an acceleration: "contact", "constraint" (a screw, joint friction);
    - of an impact: "grazing", "simultaneous" with others, "witness" (several nearest points), "friction" at its limit,
      "restitution" that was lowered, "map" (an implicit map without an answer), "start" (at the first instant), "time"
      (a force that jumps, in a step whose time moves);
    - of a persistent contact: "release", "stick", "redundant" points that share a load, "node" (an event at the end of
      a step), "inside" of a step, "dense" steps;
    - "law": a law of contact for which files of older versions lack what derivatives need, or dense steps have none;
    - "second": there is a first derivative, but no second one that is known.
    """

    def __init__(
        self,
        what: str,
        *,
        reason: str | None = None,
        pair: tuple[str, str] | None = None,
        time: float | None = None,
        **texts: Unpack[_Texts],
    ) -> None:
        self.reason, self.pair, self.time = reason, pair, time
        super().__init__(what, **texts)


class AccuracyWarning(UserWarning):
    """A run is less accurate than was asked or is promised.

    With dt="auto" it did not reach `tol`, and `Trajectory.error_estimate` is what it reached; or bodies overlap, or the
    energy rose, by more than what is documented as the error of a step, or dense steps did not meet Coulomb's law by
    half of the speeds (`Trajectory.contact_changes` with "overlap", `Trajectory.dense_steps`).
    """


class DenseStepWarning(UserWarning):
    """A run with contact_mode="auto" took dense steps: impacts in them have no times (`Trajectory.dense_steps`)."""


class ApproximateDerivativeWarning(UserWarning):
    """A gradient goes through dense steps whose derivative is approximate (`Sensitivity.report` names them)."""


class UnusedSettingWarning(UserWarning):
    """What was set has no effect.

    A default of contacts that none of the shapes uses, because files give their own, or a value of a pair that is not
    tested for contact.
    """


class UntestedPairWarning(UserWarning):
    """A run does not test a pair of shapes, of which the user has added one: they overlap in the start and in neutral.

    There the model's own pose makes them overlap, and they pass through each other.
    """


class AngleUnitWarning(UserWarning):
    """An angle of more than a turn was given where a joint or a placement has less: are these degrees? They are rad.

    Of joints without end, whose angles may be any, and of the files of models nothing is said.
    """


class DeprecatedWarning(FutureWarning):
    """An old name, or an old meaning of one, that is understood for this release; the text says the new one."""


class TornMeshWarning(UserWarning):
    """The file of a mesh consists of several, which were not told apart: its faces are wrong, its hull is right."""


def nearest(word: str, choices: Iterable[str], cutoff: float = 0.5) -> str | None:
    """Return the choice most like `word`, or None when nothing is near; `cutoff` is difflib's, from 0 to 1."""
    names = [str(choice) for choice in choices]
    same = [name for name in names if name.lower() == word.lower()]
    found = same or difflib.get_close_matches(word, names, n=1, cutoff=cutoff)
    if not found:
        lower = {name.lower(): name for name in names}
        found = [lower[key] for key in difflib.get_close_matches(word.lower(), list(lower), n=1, cutoff=cutoff)]
    return found[0] if found else None


def did_you_mean(word: str, choices: Iterable[str]) -> str:
    """Return a remedy sentence: the nearest choice if there is one, else the first few choices."""
    names = list(dict.fromkeys(map(str, choices)))
    near = nearest(word, names)
    if near is not None:
        return f"Did you mean {near!r}?"
    if not names:
        return "There is none to choose from: add one first"
    shown = ", ".join(repr(name) for name in names[:12])
    return f"Use one of {shown}" + (", ..." if len(names) > 12 else "")
