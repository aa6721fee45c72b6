"""Actuators of an MJCF: linear ones without a state on one joint become servos, or are what inputs go through."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from contactvi.importing.mjcf.compiler import Source


@dataclass(frozen=True)
class Actuator:
    """An actuator of an MJCF on one joint, or the adhesion of one body, with the scene's names.

    Attributes:
        kind: "motor" (an input of the joint), "position" or "velocity" (a servo of the joint), "adhesion" (a pull of
            the body on all that it touches: `Scene.set_body_adhesion`).
        joint: that of the actuator, "" for adhesion.
        gear, gain, offset: the joint force of a motor is gear (gain ctrl + offset) [N m or N].
        kp, kd: of the servo [N m/rad or N/m], [N m s/rad or N s/m].
        control_range: to which ctrl is cut.
        effort: largest joint force [N m or N], inf for none.
        body: that of adhesion, else "".
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
    body: str = ""

    def force(self, ctrl: float) -> float:
        """Return the joint force [N m or N] of a motor, or the pull [N] of adhesion, for a control signal."""
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
    if over not in ("joint", "jointinparent", "body"):
        return f"acts on a {over}, not on a joint or a body"
    if state != "none":
        return f"has a state ({state})"
    if gain != "fixed" or bias not in ("none", "affine"):
        return f"its force is not linear ({gain}, {bias})"
    if over == "body":
        body = int(m.actuator_trnid[a, 0])
        return "" if m.body_weldid[body] != 0 and bias == "none" else "adhesion of a body that is fixed, or has a bias"
    if source.word("Joint", m.jnt_type[int(m.actuator_trnid[a, 0])]) in ("free", "ball"):
        return "acts on a ball or free joint"
    if bias == "affine" and max(m.actuator_biasprm[a][1:3]) > 0.0:
        return "has a feedback that drives away"
    if float(m.actuator_gear[a, 0]) == 0.0:
        return "has gear 0"
    return ""


def _actuator(source: Source, a: int, prefix: str) -> Actuator:
    m, name = source.m, source.names["actuator"][a]
    if source.word("Trn", m.actuator_trntype[a]) == "body":
        return _adhesion(source, a, prefix)
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


def _adhesion(source: Source, a: int, prefix: str) -> Actuator:
    m, name = source.m, source.names["actuator"][a]
    limited, cut = bool(m.actuator_forcelimited[a]), (0.0, np.inf)
    if m.actuator_ctrllimited[a]:
        cut = max(0.0, float(m.actuator_ctrlrange[a, 0])), max(0.0, float(m.actuator_ctrlrange[a, 1]))
    body = prefix + source.names["body"][int(m.actuator_trnid[a, 0])]
    text = f"pulls once scene.set_body_adhesion({body!r}, ...) gives its control; what lets go leaves its share"
    source.report.note("changed", "actuator", name, text)
    return Actuator(
        name=prefix + name,
        kind="adhesion",
        joint="",
        gear=1.0,
        gain=float(m.actuator_gainprm[a][0]),
        control_range=cut,
        effort=max(float(m.actuator_forcerange[a, 1]), 0.0) if limited else np.inf,
        body=body,
    )
