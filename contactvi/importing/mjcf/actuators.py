"""Actuators of an MJCF: linear ones without a state on one joint become servos, or are what inputs go through."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from contactvi.importing.mjcf.compiler import Source


@dataclass(frozen=True)
class Actuator:
    """An actuator of an MJCF on one joint, with the scene's names.

    Attributes:
        kind: "motor" (an input of the joint), "position" or "velocity" (a servo of the joint).
        gear, gain, offset: the joint force of a motor is gear (gain ctrl + offset) [N m or N].
        kp, kd: of the servo [N m/rad or N/m], [N m s/rad or N s/m].
        control_range: to which ctrl is cut.
        effort: largest joint force [N m or N], inf for none.
    """

    name: str
    kind: str
    joint: str
    gear: float
    gain: float
    offset: float = 0.0
    kp: float = 0.0
    kd: float = 0.0
    control_range: tuple[float, float] = (-np.inf, np.inf)
    effort: float = np.inf

    def force(self, ctrl: float) -> float:
        """Return the joint force [N m or N] of a motor for a control signal."""
        force = self.gear * (self.gain * self._cut(ctrl) + self.offset)
        return float(min(max(force, -self.effort), self.effort))

    def target(self, ctrl: float) -> float:
        """Return the position [rad or m] or the velocity [rad/s or m/s] that a servo has as target."""
        return (
            self.gear * (self.gain * self._cut(ctrl) + self.offset) / (self.kp if self.kind == "position" else self.kd)
        )

    def _cut(self, ctrl: float) -> float:
        return min(max(ctrl, self.control_range[0]), self.control_range[1])


def actuators_of(source: Source, prefix: str) -> list[Actuator]:
    """Return the actuators that the engine has, and note the others."""
    m, found = source.m, []
    if source.off("ACTUATION"):
        return []
    for a, name in enumerate(source.names["actuator"]):
        why = _unused(source, a)
        if why:
            source.lose("actuator", name, why)
            continue
        made = _actuator(source, a, prefix)
        found.append(made)
        if any(np.any(getattr(m, field)[a]) for field in ("actuator_armature", "actuator_damping")):
            source.lose("actuator", name, "armature or damping of the actuator")
    return found


def _unused(source: Source, a: int) -> str:
    """Return why an actuator cannot be used, nothing where it can."""
    m = source.m
    over, state = source.word("Trn", m.actuator_trntype[a]), source.word("Dyn", m.actuator_dyntype[a])
    gain, bias = source.word("Gain", m.actuator_gaintype[a]), source.word("Bias", m.actuator_biastype[a])
    if over not in ("joint", "jointinparent"):
        return f"acts on a {over}, not on a joint"
    if state != "none":
        return f"has a state ({state})"
    if gain != "fixed" or bias not in ("none", "affine"):
        return f"its force is not linear ({gain}, {bias})"
    if source.word("Joint", m.jnt_type[int(m.actuator_trnid[a, 0])]) in ("free", "ball"):
        return "acts on a ball or free joint"
    if bias == "affine" and max(m.actuator_biasprm[a][1:3]) > 0.0:
        return "has a feedback that drives away"
    if float(m.actuator_gear[a, 0]) == 0.0:
        return "has gear 0"
    return ""


def _actuator(source: Source, a: int, prefix: str) -> Actuator:
    m, name = source.m, source.names["actuator"][a]
    affine = source.word("Bias", m.actuator_biastype[a]) == "affine"
    b0, b1, b2 = (float(x) for x in m.actuator_biasprm[a][:3]) if affine else (0.0, 0.0, 0.0)
    gear = float(m.actuator_gear[a, 0])
    low, high = (float(x) for x in m.actuator_forcerange[a]) if m.actuator_forcelimited[a] else (-np.inf, np.inf)
    if -low != high:
        source.report.note("changed", "actuator", name, "forcerange that is not symmetric: the smaller bound counts")
    cut = (-np.inf, np.inf)
    if m.actuator_ctrllimited[a]:
        cut = float(m.actuator_ctrlrange[a, 0]), float(m.actuator_ctrlrange[a, 1])
    return Actuator(
        name=prefix + name,
        kind="position" if b1 else "velocity" if b2 else "motor",
        joint=prefix + source.names["joint"][int(m.actuator_trnid[a, 0])],
        gear=gear,
        gain=float(m.actuator_gainprm[a][0]),
        offset=b0,
        kp=abs(b1) * gear**2,
        kd=abs(b2) * gear**2,
        control_range=cut,
        effort=abs(gear) * max(min(-low, high), 0.0),
    )
