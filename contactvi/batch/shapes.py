"""The inputs of a batch of runs: which shapes they may have, and which they are brought to.

An input may have one leading dimension more than one run takes: the runs of the batch. Those that have none are the
same in all runs. Only shapes are looked at here, so that array libraries can ask before they have numbers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from contactvi.errors import InputError
from contactvi.inputs import count
from contactvi.trajectory.compiled import compile_scene

if TYPE_CHECKING:
    from contactvi.scene.scene import Scene

Shape = tuple[int, ...]
OF_STEPS = ("control", "target")  # they have a row for every step
OF_RUNS = ("q0", "v0", *OF_STEPS)  # the inputs besides parameters


@dataclass(frozen=True)
class Batch:
    """The shapes of the inputs of a batch of runs.

    Attributes:
        size: number of runs; None where no input has a leading dimension: one run, without that dimension.
        steps: number of steps of every run.
        single: shapes of one run, by the names of the inputs.
        full: shapes of all runs: with the leading dimension, but for parameters that are the same in all runs.
    """

    size: int | None
    steps: int
    single: Mapping[str, Shape]
    full: Mapping[str, Shape]

    @property
    def runs(self) -> int:
        """Number of runs."""
        return 1 if self.size is None else self.size


def batch_of(scene: Scene, shapes: Mapping[str, Shape], steps: int | None) -> Batch:
    """Return the shapes of a batch of runs.

    Args:
        scene: the scene of the runs.
        shapes: of the inputs that are given: "q0", "v0", "control", "target", and the names of parameters.
        steps: number of steps, where neither control nor target tells it.

    Raises:
        InputError: for shapes that do not fit the scene or each other; for an unknown parameter.
    """
    number = _steps(shapes, steps)
    single = {name: _of_one_run(scene, name, shape, number) for name, shape in shapes.items()}
    leading = {name: leading_of(name, shape, single[name]) for name, shape in shapes.items()}
    size = size_of(leading)
    full = {
        name: shape if name not in OF_RUNS and leading[name] in (None, 1) else (size or 1, *shape)
        for name, shape in single.items()
    }
    return Batch(size, number, single, full)


def _steps(shapes: Mapping[str, Shape], steps: int | None) -> int:
    """Return the number of steps that the inputs have in common."""
    found = {name: shapes[name][-2] for name in OF_STEPS if name in shapes and len(shapes[name]) >= 2}
    if steps is not None:
        found["steps"] = count("steps", steps)
    if not found:
        given = [name for name in OF_STEPS if name in shapes]
        raise InputError(
            "The number of steps is not known", name="steps", expected="steps=..., or inputs with a row for each step",
            got=f"{given[0]} of shape {shapes[given[0]]}" if given else "neither", remedy="Give steps=100",
        )  # fmt: skip
    numbers = set(found.values())
    if len(numbers) > 1 or 0 in numbers:
        raise InputError(
            "The inputs have different numbers of steps" if len(numbers) > 1 else "There is no step to make",
            name=next(iter(found)), expected="one number of steps >= 1",
            got=", ".join(f"{name} {number}" for name, number in found.items()),
            remedy="Give a row of every input for each step",
        )  # fmt: skip
    return numbers.pop()


def _of_one_run(scene: Scene, name: str, shape: Shape, steps: int) -> Shape:
    """Return the shape that an input of one run has; of targets that with velocities where these are given."""
    states = compile_scene(scene).states
    if name == "target":
        joints = len(scene.servo_joints)
        if joints == 0:
            raise InputError(
                "There is nothing that follows a target", name="target", expected="a scene with servos", got="none",
                remedy="Call scene.set_servo(joint, kp, kd) first, or leave target out",
            )  # fmt: skip
        return (steps, 2 * joints if shape[-1:] == (2 * joints,) else joints)
    known = {"q0": (states.nq,), "v0": (states.nv,), "control": (steps, states.nv)}
    return known[name] if name in known else tuple(scene.parameter(name).shape)


def leading_of(name: str, shape: Shape, single: Shape) -> int | None:
    """Return the leading dimension of an input, None where it has none; one number may stand for shape (1,)."""
    if shape == single or (name not in OF_RUNS and math.prod(single) == 1 and shape == ()):
        return None
    if len(shape) == len(single) + 1 and shape[1:] == single and shape[0] > 0:
        return shape[0]
    column = single == (1,) and len(shape) == 1
    raise InputError(
        f"{name} has the wrong shape", name=name, expected=f"{single}, or (runs, {', '.join(map(str, single))})",
        got=shape, remedy="Give values[:, None], a row with one number for each run" if column
        else "Give one run, or one row for each run of the batch",
    )  # fmt: skip


def size_of(leading: Mapping[str, int | None]) -> int | None:
    """Return the number of runs; a leading dimension of 1 is the same in all of them."""
    given = {name: size for name, size in leading.items() if size is not None}
    several = {name: size for name, size in given.items() if size != 1}
    if len(set(several.values())) > 1:
        raise InputError(
            "The inputs are of batches of different sizes", name=next(iter(several)), expected="one number of runs",
            got=", ".join(f"{name} {size}" for name, size in several.items()),
            remedy="Leave the leading dimension out where an input is the same in all runs",
        )  # fmt: skip
    return next(iter(several.values()), 1) if given else None
