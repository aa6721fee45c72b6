"""Surfaces that move along themselves while their bodies stay: belts, treadmills, turntables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from contactvi.inputs import vector
from contactvi.scene.number_functions import NumberFunction, NumberTable, number_function


@dataclass(frozen=True)
class SurfaceMotion:
    """The velocity field of a surface beside that of its body: profile(t) (linear + angular x r).

    Attributes:
        linear: [m/s], shape (3,), in the frame of the geometry.
        angular: [rad/s], shape (3,), about the origin of the geometry.
        profile: factor by the time; None: 1.
    """

    linear: tuple[float, ...]
    angular: tuple[float, ...]
    profile: NumberFunction | None = None

    @classmethod
    def checked(cls, linear: ArrayLike, angular: ArrayLike, profile: Any) -> SurfaceMotion:
        """Return the motion with these numbers; InputError for bad ones."""
        given = None if profile is None else number_function("profile", profile, -np.inf, np.inf, "s")
        return cls(tuple(vector("linear", linear, 3)), tuple(vector("angular", angular, 3)), given)

    @property
    def moves(self) -> bool:
        """Whether the field is not zero."""
        return any(self.linear) or any(self.angular)

    @property
    def storable(self) -> bool:
        """Whether it holds no function."""
        return self.profile is None or self.profile.storable

    def engine(self, geometry: str) -> tuple[np.ndarray, np.ndarray, Any]:
        """Return it as the engine takes it; the name is for the messages of what goes wrong in its function."""
        name = f"the profile of the surface of {geometry!r}"
        return np.array(self.linear), np.array(self.angular), self.profile and self.profile.engine(name)

    def words(self) -> str:
        """Return it as text."""
        parts = [
            f"{size} {unit}" for size, unit in ((list(self.linear), "m/s"), (list(self.angular), "rad/s")) if any(size)
        ]
        return " and ".join(parts) + (" times a function of the time" if self.profile is not None else "")


def motions_to_data(motions: Mapping[str, SurfaceMotion]) -> list[dict[str, Any]]:
    """Return what can be stored of the motions of surfaces, by the names of their geometries, as plain data."""
    rows = []
    for name, motion in motions.items():
        if motion.storable:
            row: dict[str, Any] = {"geometry": name, "linear": list(motion.linear), "angular": list(motion.angular)}
            if isinstance(motion.profile, NumberTable):
                row["profile"] = motion.profile.to_data()
            rows.append(row)
    return rows


def motions_from_data(rows: Sequence[Mapping[str, Any]]) -> dict[str, SurfaceMotion]:
    """Return what `motions_to_data` described."""
    found = {}
    for row in rows:
        profile = row.get("profile")
        table = None if profile is None else np.transpose(profile)
        found[str(row["geometry"])] = SurfaceMotion.checked(row["linear"], row["angular"], table)
    return found
