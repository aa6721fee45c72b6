"""Gradients of costs of runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactvi.errors import InputError
from contactvi.inputs import short
from contactvi.trajectory.trajectory import Trajectory

Array = NDArray[np.float64]
Cost = Callable[[Array, Array, Array], tuple[float, Array, Array]] | tuple[Any, Any]


def gradient(
    traj: Trajectory, cost: Cost, wrt: Sequence[str] | str = ("q0", "v0"), *, on_kink: str = "raise"
) -> tuple[float | None, dict[str, Array]]:
    """Return a cost J of a run and its exact gradient, by one pass backward through the run.

    The price is that of a few runs, however many inputs there are.

    Args:
        traj: a run with record="gradient".
        cost: a function of the nodes (t (N,), q (N, nq), v (N, nv)) that returns (J, dJ/dq, dJ/dv), or the pair (dJ/dq,
            dJ/dv) itself; gradients are dual to Pinocchio's tangent vectors, of shape (N, nv), or (nv,) for a cost of
            the last node alone.
        wrt: what the gradient is with respect to, any of

            - "q0" (nv,), tangent; "v0" (nv,); "control" (steps, nv), the forces of every step;
            - "target", "target_velocity" (steps, n): references of the n servos in every step;
            - "restitution", "friction" (1,): of all pairs that have some; "restitution:a|b" (1,): of one pair;
              "restitution:joint" (1,): of both limits of a joint;
            - "gravity" (3,);
            - "mass:joint" (1,): of the body that a joint moves, at a constant centre of mass and rotational inertia
              about it; "inertia:joint" (10,): mass, first moment, rotational inertia about the joint's frame (xx xy xz
              yy yz zz);
            - "armature:joint", "damping:joint", "rest:joint", "kp:joint", "kd:joint" (dofs,); "stiffness:joint" (1,).
        on_kink: as for Sensitivity.

    Returns:
        J, None where only its gradients were given; and the gradient by name.

    Raises:
        InputError, NotDifferentiable: as Sensitivity.

    Warns:
        ApproximateDerivativeWarning: where the run has dense steps whose derivative is approximate.
    """
    if not isinstance(traj, Trajectory):
        raise InputError(
            "There is no gradient of this", name="traj", expected="a Trajectory", got=short(traj),
            remedy="Give the run that contactvi.simulate(..., record='gradient') has returned",
        )  # fmt: skip
    return traj.gradient(cost, wrt, on_kink=on_kink)
