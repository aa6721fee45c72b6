"""Second derivatives of costs of runs along directions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from contactvi.errors import InputError
from contactvi.inputs import short
from contactvi.trajectory.gradient import Cost
from contactvi.trajectory.hessian import CostHessian
from contactvi.trajectory.hessian import HessianVector as HessianVector
from contactvi.trajectory.trajectory import Trajectory


def hessian_vector(
    traj: Trajectory,
    cost: Cost,
    w: Mapping[str, Any],
    wrt: Sequence[str] | str | None = None,
    *,
    hessp: CostHessian,
    method: str = "exact",
    on_kink: str = "raise",
) -> HessianVector:
    """Return the second derivative H of a cost of a run times a direction w, and the gradient.

    The price is that of two to three gradients, however many inputs there are.

    On configurations with turns H is the second derivative of d -> J(q0 (+) d, v0 + dv, control + du) at d = 0, (+)
    being Pinocchio's `integrate`: it is symmetric, the matrix that a Newton step in q0 (+) d needs, and its product is
    not the change of the numbers of the gradient along w, from which it differs by half of a bracket
    (docs/theory/run_derivatives.md).

    Args:
        traj: a run with record="gradient".
        cost: as for contactvi.gradient.
        w: the direction, a dict of arrays by name, of the shapes of a gradient: "q0" (nv,), "v0" (nv,), "control"
            (steps, nv), "target" and "target_velocity" (steps, servos); with method="gauss-newton" also the parameters
            and laws of contact of contactvi.gradient.
        wrt: names of the rows of H w; None: those of w.
        hessp: the second derivative of the cost: a function of (t (N,), q (N, nq), v (N, nv), dq (N, nv), dv (N, nv))
            that returns what (dJ/dq, dJ/dv) change by along (dq, dv), (N, nv) each; at each node as the second
            derivative of d -> J(q (+) d, v + dv), symmetric. Of a sum of squared residuals r it is the Jacobian's
            J_r^T J_r (dq, dv), where the second derivatives of r count for little. "linear": dJ/dq and dJ/dv are
            constant.
        method: "exact"; "gauss-newton", which leaves the second derivatives of the motion out, so that
            H = S^T (second derivative of the cost) S with the sensitivity S of the states: it is never indefinite where
            that of the cost is not, and all runs have it that have a gradient; "auto": the exact one where it is known,
            else Gauss-Newton.
        on_kink: as for Sensitivity, with Gauss-Newton.

    Returns:
        HessianVector: `product` and `gradient` by name, `value`, and `approximate`: why it is Gauss-Newton's.

    Raises:
        InputError, NotDifferentiable: as Sensitivity. NotDifferentiable with the reason "second" where there is a first
            derivative, but no second one that is known: impacts but those without friction of a corner or a ball on a
            face, a ball or a corner, or of a joint limit, with impact="ctec"; persistent contacts; parameters.
        DerivativeError: forces or potentials given in Python act, whose second derivatives are not known.
    """
    if not isinstance(traj, Trajectory):
        raise InputError(
            "There is no second derivative of this", name="traj", expected="a Trajectory", got=short(traj),
            remedy="Give the run that contactvi.simulate(..., record='gradient') has returned",
        )  # fmt: skip
    return traj.hessian_vector(cost, w, wrt, hessp=hessp, method=method, on_kink=on_kink)
