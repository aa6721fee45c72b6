"""The options of a run: those chosen for it, and those of the scene's file."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from contactvi.options import Options, merged
from contactvi.trajectory.compiled import checked_scene

if TYPE_CHECKING:
    from contactvi.scene.scene import Scene


def settings_of(scene: Scene, chosen: Mapping[str, Any], forced: bool = False) -> Options:
    """Return the options of a run: those chosen (not None), else those of the scene's file, else the defaults.

    Args:
        forced: whether it has inputs that are given by steps. These decide about a dt that is given nowhere
            (options.merged).
    """
    checked_scene(scene)
    file, here = _plain(scene.settings), _plain(chosen)
    if file is None or here is None or "tol" in scene.settings or chosen.get("tol") is not None:  # may warn each time
        return Options.from_dict(merged(scene.settings, chosen, forced))
    return _checked(file, here, forced)


_PLAIN = {str, int, float, bool, type(None)}
_Settings = tuple[tuple[tuple[str, Any], ...], tuple[type, ...]]


def _plain(settings: Mapping[str, Any]) -> _Settings | None:
    """Return settings of plain values, with their types, which tell 1 from True; None where some value is another."""
    types = tuple(map(type, settings.values()))
    return (tuple(settings.items()), types) if _PLAIN.issuperset(types) else None


@lru_cache(maxsize=64)
def _checked(file: _Settings, chosen: _Settings, fixed: bool) -> Options:
    """Return the options of these settings, checked once."""
    return Options.from_dict(merged(dict(file[0]), dict(chosen[0]), fixed))
