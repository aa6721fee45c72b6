"""The variables of a problem: inputs, free parts of the start and parameters of the scene, in one vector z."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.control.inputs import InputMap, Inputs, select_joints
from contactvi.errors import InputError, did_you_mean
from contactvi.inputs import array, listed, mapping, real_numbers, short
from contactvi.scene.element_rows import dof_names
from contactvi.scene.joints import dofs_of
from contactvi.scene.scene import Scene
from contactvi.trajectory.compiled import compile_scene

Array = NDArray[np.float64]
# Values that a scene has; a mass > 0 and what is > 0 of inertias are left to bounds of the user.
RANGES = {
    "restitution": (0.0, 1.0), "friction": (0.0, np.inf), "stiffness": (0.0, np.inf), "damping": (0.0, np.inf),
    "armature": (0.0, np.inf), "kp": (0.0, np.inf), "kd": (0.0, np.inf),
}  # fmt: skip


class Variables:
    """The blocks of z, and what a run is made with.

    Args:
        scene: the scene. q0, v0: start of reference (nq,), (nv,).
        inputs, grid: which inputs there are, and over which steps; None for none.
        free_q0, free_v0: joints whose start is free. parameters: names of Scene.parameter.

    Attributes:
        blocks: name -> slice of z: "inputs", "q0", "v0", then the parameters.
        wrt: the names of contactvi.gradient that `gradient` needs.
        z0: the values that they have without being chosen.
        names: of the entries.
    """

    def __init__(
        self, scene: Scene, q0: Any, v0: Any, inputs: Inputs | None, grid: InputMap | None,
        free_q0: Any, free_v0: Any, parameters: Sequence[str],
    ) -> None:  # fmt: skip
        compiled = compile_scene(scene)
        self._scene, self._model = scene, compiled.built.model
        states = compiled.states
        self.q0 = states.configuration(compiled.q0 if q0 is None else q0)
        start = compiled.v0 if v0 is None else v0
        self.v0 = compiled.start_velocity(self.q0, 0.0) if start is None else states.velocity(start)
        self._inputs, self.grid = inputs, grid
        self._q_joints = select_joints(scene, "free_q0", free_q0)
        self._q_dofs = [dof for joint in self._q_joints for dof in dofs_of(self._model, joint)]
        self._v_dofs = [
            dof for joint in select_joints(scene, "free_v0", free_v0) for dof in dofs_of(self._model, joint)
        ]
        self.parameters = [str(name) for name in listed("parameters", parameters, "names of Scene.parameter")]
        self.blocks: dict[str, slice] = {}
        self.z0, self.names = self._lay_out()
        self.wrt = [*(grid.names() if grid else []), *(name for name in ("q0", "v0") if name in self.blocks)]
        self.wrt += self.parameters

    def split(self, z: Array) -> dict[str, Array]:
        """Return the values by block; those of inputs have shape (rows, nu)."""
        found = {name: z[part] for name, part in self.blocks.items()}
        if self.grid is not None:
            found["inputs"] = found["inputs"].reshape(self.grid.rows, -1)
        return found

    def start(self, values: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return the start (q, v) of the run."""
        v = self.v0.copy()
        if self._v_dofs:
            v[self._v_dofs] = values["v0"]
        return (np.asarray(pin.integrate(self._model, self.q0, self._moved(values))) if self._q_dofs else self.q0), v

    def scene(self, values: Mapping[str, Array]) -> Scene:
        """Return the scene with the chosen parameters."""
        if not self.parameters:
            return self._scene
        return self._scene.with_parameters({name: values[name] for name in self.parameters})

    def gradient(self, values: Mapping[str, Array], gradients: Mapping[str, Array]) -> Array:
        """Return the gradient in z from those of a run by name."""
        found = np.zeros(len(self.z0))
        for name, part in self.blocks.items():
            if name == "inputs":
                assert self.grid is not None
                found[part] = self.grid.transposed(dict(gradients)).ravel()
            elif name == "q0":
                found[part] = self._by_free(values).T @ gradients["q0"]
            else:
                found[part] = gradients["v0"][self._v_dofs] if name == "v0" else gradients[name]
        return found

    def along(self, values: Mapping[str, Array], w: Array) -> dict[str, Array]:
        """Return the direction of a run, by the names of contactvi.gradient, from one in z."""
        parts = self.split(w)
        found: dict[str, Array] = {}
        for name, part in parts.items():
            if name == "inputs":
                assert self.grid is not None
                found |= self.grid.along(part)
            elif name == "q0":
                found["q0"] = self._by_free(values) @ part
            elif name == "v0":
                found["v0"] = np.zeros(len(self.v0))
                found["v0"][self._v_dofs] = part
            else:
                found[name] = part
        return found

    def curved(self) -> str | None:
        """Return a joint whose free start turns in space; None where its coordinates simply add."""
        for joint in self._q_joints:
            index = self._model.getJointId(joint)
            if self._model.nvs[index] > 1 and "Translation" not in self._model.joints[index].shortname():
                return joint
        return None

    def pack(self, given: Mapping[str, Any], base: Array) -> Array:
        """Return z with the values given by block, the others as in `base` (n,)."""
        z = base.copy()
        for name, value in mapping("values", given, "block: values").items():
            part = self._slice("values", name)
            z[part] = self._spread(name, value)
        return z

    def bounds(self, given: Mapping[str, Any]) -> tuple[Array, Array]:
        """Return the bounds of z: those given by block as (lower, upper), and the ranges of parameters."""
        lower, upper = np.full(len(self.z0), -np.inf), np.full(len(self.z0), np.inf)
        for name in self.parameters:
            lower[self.blocks[name]], upper[self.blocks[name]] = RANGES.get(name.partition(":")[0], (-np.inf, np.inf))
        for name, pair in mapping("bounds", given, "block: (lower, upper)").items():
            part = self._slice("bounds", name)
            if isinstance(pair, str) and pair == "limits" and name == "inputs" and self._inputs is not None:
                pair = self._inputs.limits()
            if not isinstance(pair, (list, tuple)) or len(pair) != 2:
                raise InputError(
                    f"Bounds of {name!r}", name="bounds", expected="a pair (lower, upper), or 'limits' for inputs",
                    got=short(pair), remedy=f"For example bounds={{{name!r}: (-1.0, 1.0)}}",
                )  # fmt: skip
            low, high = (self._spread(name, end, infinite=True) for end in pair)
            if np.any(low > high):
                raise InputError(
                    f"The bounds of {name!r} leave nothing", name="bounds", expected="lower <= upper",
                    got=short(pair), remedy="Give the smaller one first",
                )  # fmt: skip
            lower[part], upper[part] = np.maximum(lower[part], low), np.minimum(upper[part], high)
        return lower, upper

    def _lay_out(self) -> tuple[Array, list[str]]:
        values: list[Array] = []
        names: list[str] = []
        dofs = dof_names(self._model)
        if self.grid is not None and self._inputs is not None:
            row = np.zeros(len(self._inputs.names))
            row[len(self._inputs.torque_dofs) :] = [self._place(joint) for joint in self._inputs.target_joints]
            self._block("inputs", self.grid.rows * len(row), values)
            values.append(np.tile(row, self.grid.rows))
            names += [f"inputs[{k}] {name}" for k in range(self.grid.rows) for name in self._inputs.names]
        for block, own in (("q0", self._q_dofs), ("v0", self._v_dofs)):
            if own:
                self._block(block, len(own), values)
                values.append(np.zeros(len(own)) if block == "q0" else self.v0[own])
                names += [f"{block} {dofs[dof]}" for dof in own]
        for name in self.parameters:
            if name in self.blocks:
                raise InputError(
                    f"Parameter {name!r} is named twice", name="parameters", expected="names that differ", got=name,
                    remedy="Leave one of them out",
                )  # fmt: skip
            value = self._scene.parameter(name)
            self._block(name, len(value), values)
            values.append(value)
            names += [name] if len(value) == 1 else [f"{name}[{k}]" for k in range(len(value))]
        if not values:
            raise InputError(
                "The problem has no variables", name="inputs", expected="inputs, a free start or parameters",
                got="none of them", remedy="Give inputs=, free_q0=, free_v0= or parameters=",
            )  # fmt: skip
        return np.concatenate(values), names

    def _block(self, name: str, size: int, before: list[Array]) -> None:
        first = sum(len(part) for part in before)
        self.blocks[name] = slice(first, first + size)

    def _place(self, joint: str) -> float:
        index = self._model.getJointId(joint)
        q = self.q0[self._model.idx_qs[index] :]
        return float(q[0] if self._model.nqs[index] == 1 else np.arctan2(q[1], q[0]))

    def _moved(self, values: Mapping[str, Array]) -> Array:
        moved = np.zeros(len(self.v0))
        moved[self._q_dofs] = values["q0"]
        return moved

    def _by_free(self, values: Mapping[str, Array]) -> Array:
        """Return the tangent vectors of the start along the free coordinates, one per column."""
        moved = self._moved(values)
        return np.asarray(pin.dIntegrate(self._model, self.q0, moved, pin.ArgumentPosition.ARG1))[:, self._q_dofs]

    def _slice(self, argument: str, name: Any) -> slice:
        if name in self.blocks:
            return self.blocks[name]
        raise InputError(
            "The problem has no such variables", name=argument, expected=f"some of {', '.join(self.blocks)}",
            got=short(name), remedy=did_you_mean(str(name), list(self.blocks)),
        )  # fmt: skip

    def _spread(self, name: str, value: Any, infinite: bool = False) -> Array:
        """Return numbers for a block from one number, a row of inputs, or all of them."""
        part = self.blocks[name]
        shape: tuple[int, ...] = (part.stop - part.start,)
        if name == "inputs" and self.grid is not None:
            shape = (self.grid.rows, shape[0] // self.grid.rows)
        numbers = real_numbers(value)
        try:
            spread = np.broadcast_to(np.full(shape, np.nan) if numbers is None else numbers, shape).ravel()
        except ValueError:
            spread = np.full(part.stop - part.start, np.nan)
        if np.any(np.isnan(spread)) or (not infinite and np.any(np.isinf(spread))):
            raise InputError(
                f"Values of {name!r}", name=name, expected=f"a number, or numbers that fit to shape {shape}",
                got=short(value), remedy="Give numbers in the order of problem.names",
            )  # fmt: skip
        return spread


def checked_point(variables: Variables, z: Any) -> Array:
    """Return z (n,) as an array of its own."""
    return array("z", z, (len(variables.z0),), "the variables of the problem").copy()
