"""The state of a `Simulator`, to go back to and to pickle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from contactvi.errors import ContactviError
from contactvi.options import Options
from contactvi.simulation import engine
from contactvi.simulation.recorder import Record
from contactvi.simulation.targets import Targets
from contactvi.trajectory.compiled import CompiledScene
from contactvi.version import version

if TYPE_CHECKING:
    from contactvi import _core


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The state of a `Simulator`, opaque; it belongs to one scene and its options.

    A pickle of it holds the scene, which is built again where it is read, by the same version of contactvi:
    `Simulator.of` goes on from it with equal bits.
    """

    scene: CompiledScene
    options: Options
    engine: _core.Snapshot
    record: Record
    rest: Any

    def __copy__(self) -> Snapshot:
        """Return the snapshot itself: it is constant, and a run that starts from it copies what it changes."""
        return self

    def __deepcopy__(self, memo: Any) -> Snapshot:
        """Return the snapshot itself, as `__copy__`."""
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what pickle keeps: the engine's state as bytes."""
        kept = (self.scene, self.options, self.engine.to_bytes(), self.record, self.rest)
        return _unpickled, (version(), *kept)

    @property
    def targets(self) -> Targets:
        """What the servos follow by default."""
        found: Targets = self.rest[3]
        return found


def _unpickled(
    made_by: str, scene: CompiledScene, options: Options, state: bytes, record: Record, rest: Any
) -> Snapshot:
    """Return the snapshot of a pickle. Raises ContactviError for one of another version of contactvi."""
    if made_by != version():
        raise ContactviError(
            "A snapshot of another version of contactvi",
            expected=f"one pickled by contactvi {version()}",
            got=f"one pickled by contactvi {made_by}",
            remedy="Send the scene, q, v and t between versions, and reset there",
        )
    return Snapshot(scene, options, engine.restored(scene, state), record, rest)
