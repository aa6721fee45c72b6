"""Runs as differentiable functions of JAX: `rollout`.

JAX is not needed before `rollout` is called: pip install "contactvi[jax]".
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from contactvi.batch.shapes import batch_of
from contactvi.control.folded import FoldedGradients, FoldedRollouts
from contactvi.control.rollouts import RolloutOptions, inputs_of, settings_of
from contactvi.errors import InputError, missing_package
from contactvi.trajectory.compiled import compile_scene

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from contactvi.scene.scene import Scene


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
    """Return the states of runs at all nodes as arrays of JAX, differentiable in all inputs.

    Works under jit, grad, vmap and jacrev. Arguments, results and gradients are those of contactvi.torch.rollout.
    Arrays are of double precision: jax.config.update("jax_enable_x64", True). The runs of a batch, and those that vmap
    asks for, are made by one call in several threads. The scene is taken as it is when the function is traced.

    The function has a custom_vjp: there are gradients, and no derivatives in forward mode (jvp, jacfwd, hessian). The
    way back makes the runs again, so that nothing is kept beside the inputs. Errors of runs end the program of JAX with
    an error of its own (jax.errors.JaxRuntimeError), whose text has theirs.

    Raises:
        InputError: for inputs of the wrong shape or precision. ContactviError: JAX is missing.
    """
    jax = _jax()
    given = {name: _input(jax, name, value) for name, value in
             inputs_of(scene, q0, v0, control, target, parameters).items()}  # fmt: skip
    batch = batch_of(scene, {name: tuple(value.shape) for name, value in given.items()}, steps)
    arrays = [_filled(jax, value, batch.full[name]) for name, value in given.items()]
    folded = FoldedRollouts.of(compile_scene(scene), batch, workers, on_kink, settings_of(dt, options))
    q, v = _function(folded)(*arrays)
    return (q[0], v[0]) if batch.size is None else (q, v)


def _jax() -> Any:
    try:
        import jax
    except ImportError as error:
        raise missing_package("JAX", "jax") from error
    if not jax.config.jax_enable_x64:
        raise InputError(
            "Runs are computed in double precision", name="jax_enable_x64", expected="JAX with double precision",
            got="JAX with single precision", remedy='Call jax.config.update("jax_enable_x64", True) first',
        )  # fmt: skip
    return jax


def _input(jax: Any, name: str, value: Any) -> Any:
    """Return an input as an array of JAX; InputError where it is not of double precision."""
    if not isinstance(value, jax.Array):
        return jax.numpy.asarray(value, dtype=np.float64)
    if value.dtype != np.float64:
        raise InputError(
            "Runs are computed in double precision", name=name, expected="an array of float64", got=value.dtype,
            remedy=f"Give {name}.astype(jax.numpy.float64)",
        )  # fmt: skip
    return value


def _filled(jax: Any, value: Any, full: tuple[int, ...]) -> Any:
    return value.reshape(full) if value.size == np.prod(full) else jax.numpy.broadcast_to(value, full)


@functools.lru_cache(maxsize=64)  # so that JAX compiles a call once, not at every call
def _function(folded: FoldedRollouts) -> Any:
    """Return the states of a batch as a function of arrays with gradients."""
    jax = _jax()

    def called(function: Any, shapes: tuple[tuple[int, ...], ...], *arrays: Any) -> Any:
        results = tuple(jax.ShapeDtypeStruct(shape, np.float64) for shape in shapes)
        return jax.pure_callback(function, results, *arrays, vmap_method="expand_dims")

    @jax.custom_vjp  # type: ignore[untyped-decorator]
    def states(*arrays: Any) -> Any:
        return called(folded.states, folded.shapes, *arrays)

    def forward(*inputs: Any) -> Any:
        arrays = tuple(given.value for given in inputs)
        # What is kept may only hold arrays: which gradients are wanted is told by its structure.
        wanted = tuple(() if given.perturbed else None for given in inputs)
        return called(folded.states, folded.shapes, *arrays), (arrays, wanted)

    def backward(kept: Any, ends: Any) -> tuple[Any, ...]:
        arrays, wanted = kept
        names = tuple(name for name, mark in zip(folded.names, wanted, strict=True) if mark is not None)
        gradients = FoldedGradients(folded, names)
        found = called(gradients, gradients.shapes, *(_instantiated(jax, end) for end in ends), *arrays)
        by_name = dict(zip(names, found, strict=True))
        zeros = (jax.numpy.zeros(array.shape) for array in arrays)
        return tuple(by_name.get(name, zero) for name, zero in zip(folded.names, zeros, strict=True))

    states.defvjp(forward, backward, symbolic_zeros=True)
    return states


def _instantiated(jax: Any, gradient: Any) -> Any:
    """Return a gradient as an array, also where JAX knows that it is zero."""
    symbolic = isinstance(gradient, jax.custom_derivatives.SymbolicZero)
    return jax.numpy.zeros(gradient.shape) if symbolic else gradient


__all__ = ["rollout"]
