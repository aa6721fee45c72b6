"""Residuals of frames, the centre of mass and momentum for crocoddyl's costs, computed by the installed Pinocchio.

They take the arguments of crocoddyl's residuals of these names. Those themselves read Pinocchio's data in memory, and
end the process where crocoddyl was built with another version of Pinocchio than the installed one.
"""

from __future__ import annotations

from typing import Any

import crocoddyl
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Array = NDArray[np.float64]

BUILT_WITH = {"3.2.1": "4.0.0"}  # version of crocoddyl on PyPI: the Pinocchio that its wheels were built with
FREE_OF_PINOCCHIO = ("ResidualModelState", "ResidualModelControl")  # residuals that read no data of Pinocchio


def reads_pinocchio(residual: Any) -> bool:
    """Return whether a residual is one of crocoddyl's own that reads Pinocchio's data."""
    kind = type(residual)
    return kind.__module__.partition(".")[0] == "crocoddyl" and kind.__name__ not in FREE_OF_PINOCCHIO


class ResidualData(crocoddyl.ResidualDataAbstract):
    """The data of a residual, with Pinocchio's in `pinocchio`."""

    def __init__(self, model: Residual, collector: Any) -> None:
        crocoddyl.ResidualDataAbstract.__init__(self, model, collector)
        self.pinocchio = model.model.createData()


class Residual(crocoddyl.ResidualModelAbstract):
    """What the residuals here share.

    Attributes:
        model: the state's pin.Model. value: (data, q, v) -> the residual, shape (size,). slope: the same -> its
            derivative, shape (size, 2 nv), in tangent vectors at q and velocities.
    """

    value: Any
    slope: Any

    def __init__(self, state: Any, size: int, nu: int | None, *, velocity: bool = False) -> None:
        count = state.nv if nu is None else nu
        crocoddyl.ResidualModelAbstract.__init__(self, state, size, count, True, velocity, False)
        self.model: pin.Model = state.pinocchio

    def createData(self, collector: Any) -> ResidualData:
        return ResidualData(self, collector)

    def calc(self, data: ResidualData, x: Array, u: Array | None = None) -> None:
        data.r = self.value(data.pinocchio, np.array(x[: self.state.nq]), np.array(x[self.state.nq :]))

    def calcDiff(self, data: ResidualData, x: Array, u: Array | None = None) -> None:
        data.Rx = self.slope(data.pinocchio, np.array(x[: self.state.nq]), np.array(x[self.state.nq :]))

    def _of_q(self, slope: Array) -> Array:
        return np.hstack([slope, np.zeros_like(slope)])


class ResidualModelFramePlacement(Residual):
    """log6(pref^-1 M) of a frame's placement M in the world, (6,): linear, angular [m, rad]."""

    def __init__(self, state: Any, id: int, pref: pin.SE3, nu: int | None = None) -> None:
        super().__init__(state, 6, nu)
        self.id, self.reference = id, pref

    def value(self, data: pin.Data, q: Array, v: Array) -> Array:
        pin.framesForwardKinematics(self.model, data, q)
        return np.asarray(pin.log6(self.reference.actInv(data.oMf[self.id])).vector)

    def slope(self, data: pin.Data, q: Array, v: Array) -> Array:
        jacobian = pin.computeFrameJacobian(self.model, data, q, self.id, pin.LOCAL)
        pin.framesForwardKinematics(self.model, data, q)
        return self._of_q(pin.Jlog6(self.reference.actInv(data.oMf[self.id])) @ jacobian)


class ResidualModelFrameTranslation(Residual):
    """The place of a frame's origin in the world less xref, (3,) [m]."""

    def __init__(self, state: Any, id: int, xref: Array, nu: int | None = None) -> None:
        super().__init__(state, 3, nu)
        self.id, self.reference = id, np.array(xref, dtype=float)

    def value(self, data: pin.Data, q: Array, v: Array) -> Array:
        pin.framesForwardKinematics(self.model, data, q)
        return np.asarray(data.oMf[self.id].translation - self.reference)

    def slope(self, data: pin.Data, q: Array, v: Array) -> Array:
        jacobian = pin.computeFrameJacobian(self.model, data, q, self.id, pin.LOCAL_WORLD_ALIGNED)
        return self._of_q(jacobian[:3])


class ResidualModelFrameVelocity(Residual):
    """The twist of a frame less vref, (6,): linear, angular [m/s, rad/s], in the axes of `type`."""

    def __init__(self, state: Any, id: int, vref: pin.Motion, type: pin.ReferenceFrame, nu: int | None = None) -> None:
        super().__init__(state, 6, nu, velocity=True)
        self.id, self.reference, self.type = id, vref, type

    def value(self, data: pin.Data, q: Array, v: Array) -> Array:
        pin.forwardKinematics(self.model, data, q, v)
        return np.asarray((pin.getFrameVelocity(self.model, data, self.id, self.type) - self.reference).vector)

    def slope(self, data: pin.Data, q: Array, v: Array) -> Array:
        pin.computeForwardKinematicsDerivatives(self.model, data, q, v, np.zeros(self.model.nv))
        by_q, by_v = pin.getFrameVelocityDerivatives(self.model, data, self.id, pin.LOCAL)
        pin.updateFramePlacement(self.model, data, self.id)
        if self.type == pin.LOCAL:
            return np.hstack([by_q, by_v])
        # Of Ad_M w, w the twist in the frame and xi the change of M in it: Ad_M (dw - ad_w xi). The world's axes at the
        # frame's origin turn with it alone.
        change, place = np.array(by_v), pin.SE3(data.oMf[self.id])
        if self.type == pin.LOCAL_WORLD_ALIGNED:
            change[:3], place.translation = 0.0, np.zeros(3)
        twist = pin.getFrameVelocity(self.model, data, self.id, pin.LOCAL)
        return np.asarray(place.action @ np.hstack([by_q - twist.action @ change, by_v]))


class ResidualModelCoMPosition(Residual):
    """The centre of mass in the world less cref, (3,) [m]."""

    def __init__(self, state: Any, cref: Array, nu: int | None = None) -> None:
        super().__init__(state, 3, nu)
        self.reference = np.array(cref, dtype=float)

    def value(self, data: pin.Data, q: Array, v: Array) -> Array:
        return np.asarray(pin.centerOfMass(self.model, data, q) - self.reference)

    def slope(self, data: pin.Data, q: Array, v: Array) -> Array:
        return self._of_q(pin.jacobianCenterOfMass(self.model, data, q))


class ResidualModelCentroidalMomentum(Residual):
    """The momentum about the centre of mass less href, (6,): linear, angular, world axes [kg m/s, kg m^2/s]."""

    def __init__(self, state: Any, href: Array, nu: int | None = None) -> None:
        super().__init__(state, 6, nu, velocity=True)
        self.reference = np.array(href, dtype=float)

    def value(self, data: pin.Data, q: Array, v: Array) -> Array:
        return np.asarray(pin.computeCentroidalMomentum(self.model, data, q, v).vector - self.reference)

    def slope(self, data: pin.Data, q: Array, v: Array) -> Array:
        found = pin.computeCentroidalDynamicsDerivatives(self.model, data, q, v, np.zeros(self.model.nv))
        return np.hstack([found[0], found[3]])
