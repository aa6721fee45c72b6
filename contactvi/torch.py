"""Runs as differentiable functions of PyTorch: `rollout`.

PyTorch is not needed before `rollout` is called: pip install "contactvi[torch]".
"""

from __future__ import annotations

import atexit
import functools
import weakref
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from contactvi.batch.shapes import batch_of
from contactvi.control.rollouts import RolloutOptions, Rollouts, inputs_of, rollouts_of, settings_of
from contactvi.errors import ContactviError, InputError, missing_package

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from contactvi.scene.scene import Scene


# Runs that tensors keep. PyTorch does not let go of them while Python ends, where they would count as lost.
_KEPT: weakref.WeakSet[Rollouts] = weakref.WeakSet()


def rollout(
    scene: Scene,
    q0: Any,
    v0: Any,
    control: Any = None,
    target: Any = None,
    *,
    dt: float,
    steps: int | None = None,
    parameters: Mapping[str, Any] | None = None,
    workers: int | None = None,
    on_kink: str = "raise",
    **options: Unpack[RolloutOptions],
) -> tuple[Any, Any]:
    """Return the states of runs at all nodes as tensors, differentiable once in all inputs.

    Gradients are exact, by the adjoint of each run; see contactvi.gradient. Inputs are tensors of double precision on
    the CPU, or what becomes one; each may have a leading dimension, the runs of a batch, and those that have none are
    the same in all runs. The runs of a batch are made in several threads.

    Args:
        scene: the scene, as it is now.
        q0: start, Pinocchio's numbers, (nq,) or (B, nq). v0: its velocity, (nv,) or (B, nv). The gradient in q0 has no
            part along changes of the norm of quaternions and of pairs (cos, sin), which are brought to norm 1.
        control: generalized forces in every step [N, N m], (steps, nv) or (B, steps, nv).
        target: references of the n servos in every step, (steps, n) or (B, steps, n); with those of their velocities
            2 n numbers. Scenes with servos need it.
        dt: time step [s]. steps: number of steps, where neither control nor target tells it.
        parameters: values of the scene's parameters by the names of contactvi.gradient, such as "mass:box", (width,) or
            (B, width).
        workers: number of threads; None for one per core. Results do not depend on it.
        on_kink: as for contactvi.gradient.
        **options: order, solver_tol, impact, contact_mode, dt_contact, ... of `Options`.

    Returns:
        q, (steps + 1, nq) or (B, steps + 1, nq), and v, (steps + 1, nv) or (B, steps + 1, nv).

    Raises:
        InputError: for inputs of the wrong shape, type or place. Errors of a run have its index in the batch in their
            message: PenetrationError, SimulationError and others of `simulate`; on the way back NotDifferentiable.
        ContactviError: PyTorch is missing; a second derivative is asked for.
    """
    torch = _torch()
    given = {name: _tensor(torch, name, value) for name, value in
             inputs_of(scene, q0, v0, control, target, parameters).items()}  # fmt: skip
    settings = settings_of(dt, options)
    batch = batch_of(scene, {name: tuple(value.shape) for name, value in given.items()}, steps)
    tensors = [_filled(torch, value, batch.full[name]) for name, value in given.items()]

    def run(arrays: list[Any]) -> Rollouts:
        return rollouts_of(scene, dict(zip(given, arrays, strict=True)), batch.steps, workers, on_kink, settings)

    q, v = _functions()[0].apply(run, *tensors)
    return (q[0], v[0]) if batch.size is None else (q, v)


@atexit.register
def _forget() -> None:
    for runs in list(_KEPT):
        runs.forget()


def _torch() -> Any:
    try:
        import torch
    except ImportError as error:
        raise missing_package("PyTorch", "torch") from error
    return torch


def _tensor(torch: Any, name: str, value: Any) -> Any:
    """Return an input as a tensor; InputError where it is on another device, or not of double precision."""
    if not isinstance(value, torch.Tensor):
        return torch.as_tensor(value, dtype=torch.float64)
    if value.device.type != "cpu":
        raise InputError(
            "Runs are computed on the CPU", name=name, expected="a tensor on the CPU", got=f"one on {value.device}",
            remedy=f"Give {name}.cpu(): gradients go back through it",
        )  # fmt: skip
    if value.dtype != torch.float64:
        raise InputError(
            "Runs are computed in double precision", name=name, expected="a tensor of torch.float64", got=value.dtype,
            remedy=f"Give {name}.double(), or call torch.set_default_dtype(torch.float64) first",
        )  # fmt: skip
    return value


def _filled(torch: Any, value: Any, full: tuple[int, ...]) -> Any:
    return value.reshape(full) if value.numel() == torch.Size(full).numel() else torch.broadcast_to(value, full)


@functools.cache
def _functions() -> tuple[Any, Any]:
    """Return the runs and their gradients as functions of autograd, whose base class is known after the import."""
    torch = _torch()

    class Runs(torch.autograd.Function):  # type: ignore[misc, name-defined]
        """(run, tensors) -> (q, v)."""

        @staticmethod
        def forward(ctx: Any, run: Any, *tensors: Any) -> tuple[Any, Any]:
            ctx.runs = run([tensor.detach().numpy() for tensor in tensors])
            _KEPT.add(ctx.runs)
            ctx.save_for_backward(*tensors)
            return torch.from_numpy(ctx.runs.q), torch.from_numpy(ctx.runs.v)

        @staticmethod
        def backward(ctx: Any, gq: Any, gv: Any) -> tuple[Any, ...]:
            return None, *Gradients.apply(ctx.runs, ctx.needs_input_grad[1:], gq, gv, *ctx.saved_tensors)

    class Gradients(torch.autograd.Function):  # type: ignore[misc, name-defined]
        """(runs, which, gq, gv, tensors) -> gradients of those tensors that are wanted; it has no derivative."""

        @staticmethod
        def forward(ctx: Any, runs: Rollouts, which: tuple[bool, ...], gq: Any, gv: Any, *tensors: Any) -> Any:
            names = [name for name, wanted in zip(runs.names, which, strict=True) if wanted]
            rows = runs.gradients(gq.detach().numpy(), gv.detach().numpy(), names)
            return tuple(
                torch.from_numpy(rows[name].reshape(-1, *tensor.shape).sum(0)) if wanted else None
                for name, tensor, wanted in zip(runs.names, tensors, which, strict=True)
            )

        @staticmethod
        def backward(ctx: Any, *_: Any) -> Any:
            raise ContactviError(
                "The gradient of runs has no derivative in PyTorch", expected="first derivatives of rollout",
                got="a derivative of its gradient",
                remedy="Take create_graph=True away; contactvi.hessian_vector gives second derivatives of a run",
            )  # fmt: skip

    return Runs, Gradients


__all__ = ["rollout"]
