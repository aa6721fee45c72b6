"""A scene as its runs need it: taken as it is at the start of a run, compiled once and again after an edit."""

from __future__ import annotations

import contextlib
import threading
import warnings
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from contactvi.aliases import callers
from contactvi.elements.forces import UserForce, UserPotential
from contactvi.errors import (
    ConstraintError,
    DerivativeError,
    InputError,
    SceneError,
    UntestedPairWarning,
    UserFunctionError,
)
from contactvi.importing.checks import dof_joint
from contactvi.inputs import short
from contactvi.records.work import ConstraintRows
from contactvi.scene import closure as loops
from contactvi.scene.derivative_check import GENERIC, check_element, mover
from contactvi.scene.scene import Scene

if TYPE_CHECKING:
    from contactvi import _core

# Of a velocity of size 1 that becomes a momentum and a velocity again. Of good robots 1e-14 is lost, and half where a
# motion has no inertia; in between, this share of every velocity of a run is rounding.
MOST_LOST = 1e-3
_MOST_STARTS = 32  # sets of pairs, of the last starts, whose scenes are kept


class CompiledScene:
    """A scene that is ready to run: a copy that later edits do not reach, the engine's scene, names, checks of states.

    Attributes:
        built: the complete scene.
        core: the engine's (contactvi._core.Scene).
        states: checks of states and forces.
        pair_names: of the tested pairs, engine order.
        joint_names: of all joints, that of the world included.
        shape_groups: names of the shapes of every part and body.
        damping: of the joints, shape (nv,).
        step_options: the options of the step that was linearised last, with what they were made from.
        engines: of simulations, by their settings, which nobody uses now.
        linearizers: engines that linearise steps, by order and tolerance, which nobody uses now.
        empty_logs: logs without rows, by kind, which runs without events share.

    Of the pairs that overlap at the neutral pose a run tests those that are apart in its start. A compiled scene tests
    one set of them; `at_start` returns the one for a start, which is made once for each set.
    """

    def __init__(self, scene: Scene, base: CompiledScene | None = None) -> None:
        """Compile a scene; base: that of other starts, with which it shares what was made for them."""
        built = scene.built()
        _refuse_missing(scene)
        self.core: _core.Scene = scene.core()
        self.built = built
        self._scene = scene.copy()
        self.states = built.states
        self.pair_names = built.pairs
        self.joint_names = [str(name) for name in built.model.names]
        self.shape_groups = scene.names.shape_groups
        self.damping: NDArray[np.float64] = np.array(built.model.damping, dtype=float)
        self._derivatives_checked = False
        self.step_options: tuple[Any, Any] | None = None
        self.engines: dict[tuple[Any, ...], list[_core.Simulator]] = {}
        self.linearizers: dict[tuple[int, float], list[_core.Linearizer]] = {}
        self.empty_logs: dict[str, Any] = {}
        self._base = self if base is None else base
        self._by_apart: dict[
            frozenset[tuple[str, str]], CompiledScene
        ] = {}  # of the base, the last one used at its end
        self._lock = threading.Lock()
        self._told: set[tuple[str, str]] = set()  # untested pairs of which the base has warned

    def at_start(self, q: Any) -> CompiledScene:
        """Return the scene with the pairs that a run from q (nq,) tests; None: from the start of the scene.

        Warns (UntestedPairWarning), once for each pair, where shapes of two parts, of which the user has added one to
        the other, overlap there as in neutral, and are not tested.

        Raises:
            InputError: for a bad q.
        """
        overlaps = self.built.overlaps
        if not len(overlaps):
            return self
        at = overlaps.apart(self.states.configuration(self.q0 if q is None else q))
        self._warn_of_untested(np.flatnonzero(~at & ~overlaps.same_part))
        if np.array_equal(at, overlaps.tested):
            return self
        base, names = self._base, overlaps.names
        wanted = frozenset(names[k] for k in np.flatnonzero(at))
        if np.array_equal(at, base.built.overlaps.tested):
            return base
        with base._lock:
            found = base._by_apart.pop(wanted, None) or CompiledScene(base._scene.with_apart(wanted), base)
            base._by_apart[wanted] = found  # now the last one
            if len(base._by_apart) > _MOST_STARTS:
                del base._by_apart[next(iter(base._by_apart))]
        return found

    def same_but_start(self, other: CompiledScene) -> bool:
        """Return whether both are of one scene, perhaps with pairs for other starts."""
        return self._base is other._base

    def _warn_of_untested(self, untested: NDArray[np.intp]) -> None:
        overlaps, told = self.built.overlaps, self._base._told
        new = [k for k in untested.tolist() if overlaps.names[k] not in told]
        if not new:
            return
        told.update(overlaps.names[k] for k in new)
        listed = ", ".join(f"{a!r} and {b!r}" for a, b in (overlaps.names[k] for k in new[:3]))
        more = f" and {len(new) - 3} more" if len(new) > 3 else ""
        warnings.warn(
            f"Not tested for contact, because they overlap in the start as in neutral: {listed}{more}."
            " Start where they are apart, or move what you have added; scene.disable_pair(a, b) says that it is meant",
            UntestedPairWarning, stacklevel=callers(),
        )  # fmt: skip

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what pickle keeps: the scene, of which all else is made again."""
        return compile_scene, (self._scene,)

    def scene(self) -> Scene:
        """Return a new copy of the scene as it was, for the caller to keep and edit; what is built is shared."""
        return self._scene.copy()

    def fits(self, scene: Scene) -> bool:
        """Return whether the scene is still as it was."""
        kept = self._scene
        same = scene.built() is self.built and scene.q0 is kept.q0 and scene.v0 is kept.v0
        return same and scene.settings == kept.settings and scene.camera == kept.camera

    @property
    def q0(self) -> Any:
        """Configuration with which runs start, shape (nq,): that of the scene, else neutral."""
        return self.built.start if self._scene.q0 is None else self._scene.q0

    @property
    def v0(self) -> Any:
        """Velocity with which runs start, shape (nv,); None is rest."""
        return self._scene.v0

    @cached_property
    def constraint_rows(self) -> list[ConstraintRows]:
        """The constraints that steps solve for, in the engine's order."""
        return [ConstraintRows(row.name, row.kind, row.rows) for row in self.built.elements.equations]

    @cached_property
    def followers(self) -> int:
        """How many joints follow others."""
        return len(self.built.elements.couplings.followers)

    @cached_property
    def loses_energy(self) -> bool:
        """Whether some pair or limit has a restitution below 1."""
        arrays = self.built.arrays
        varies = any(law.varies("restitution") for law, _ in self.built.laws)
        return bool(
            varies or np.any(self.built.restitution < 1.0) or np.any(arrays.limit_restitution[arrays.limits] < 1.0)
        )

    @cached_property
    def forced(self) -> bool:
        """Whether something besides potentials and joint damping acts: then a step is not made again without it."""
        found, arrays = self.built.elements, self.built.arrays
        acts = found.wrenches or found.forces or np.any(arrays.servo[:2])
        return bool(self.built.constrained or acts or self.dissipates)

    @cached_property
    def dissipates(self) -> bool:
        """Whether dampers or joint friction take energy, the damping of joints aside."""
        dampers = any(damping > 0.0 for *_, damping, _only in self.built.elements.springs)
        dampers |= any(row.law.dissipates for row in self.built.elements.compliances)
        return dampers or bool(np.any(self.built.arrays.joint_friction))

    @cached_property
    def driven(self) -> str | None:
        """What of the scene may put energy in, in words; None where nothing does."""
        found, arrays = self.built.elements, self.built.arrays
        reasons = {
            "servos": bool(np.any(arrays.servo[:2])),
            "wrenches": bool(found.wrenches),
            "forces given in Python": bool(found.forces),
            "laws of compliant pairs given in Python": any(not row.law.storable for row in found.compliances),
            "driven constraints": any(row.driven for row in found.constraints),
        }
        return next((what for what, is_there in reasons.items() if is_there), None)

    def start_velocity(self, q: NDArray[np.float64], t: float) -> NDArray[np.float64]:
        """Return the velocity of a start at q (nq,) for which none was given: rest, or the nearest to it, (nv,)."""
        v = np.zeros(self.states.nv)
        rows = self.built.elements.constraints
        return loops.consistent_velocity(self.core, rows, q, v, t) if rows else v

    def unreachable(self, q: NDArray[np.float64], t: float) -> ConstraintError | None:
        """Return the error that names the constraints which cannot be met at t [s] near q (nq,), None if they can."""
        rows = self.built.elements.constraints
        if not rows:
            return None
        try:
            loops.assemble(self.core, self.built.model, rows, q, (), t)
        except ConstraintError as error:
            return error
        except UserFunctionError:  # of a motion that ends there; the run has raised it if it matters
            return None
        return None

    def check_start(
        self, q: NDArray[np.float64], v: NDArray[np.float64], t: float, engine: _core.Simulator | None = None
    ) -> None:
        """Look whether a run may start at (q, v) at t [s]; engine: of the run, which then evaluates the mass matrix.

        Raises:
            SceneError: the mass matrix at q is singular to rounding: velocities there have no meaning.
            ConstraintError: (q, v) is not on the constraints.
            DerivativeError: the derivatives of the user's functions are wrong.
        """
        self._check_mass(q, engine)
        self.check_on_constraints(q, v, t)

    def check_on_constraints(self, q: NDArray[np.float64], v: NDArray[np.float64], t: float) -> None:
        """Look whether (q, v) is on the constraints at t [s], and at the user's derivatives; raises as check_start."""
        rows = self.built.elements.constraints
        if rows:
            loops.check_configuration(self.core, rows, q, t)
            loops.check_velocity(self.core, rows, q, v, t)
        if not self._derivatives_checked:
            self._derivatives_checked = True
            self._check_derivatives(q, v, t)

    @property
    def starts_unchecked(self) -> bool:
        """Whether check_start has yet to look at the derivatives of the user's functions."""
        return bool(self._scene.elements) and not self._derivatives_checked

    def check_differentiable(self) -> None:
        """Raise for what is known before a run to have no derivative.

        Raises:
            DerivativeError: a function of the user came without derivatives.
        """
        for element in self._scene.elements:
            given = element.derivatives if isinstance(element, UserForce) else True
            given = element.hessian if isinstance(element, UserPotential) else given
            if given is None:
                part = "derivatives" if isinstance(element, UserForce) else "hessian"
                raise DerivativeError(
                    f"{element.name!r} has no {part}", function=element.name, expected="a function that returns them",
                    got="none", remedy=f"Give {part}=... when it is added",
                )  # fmt: skip

    def _check_mass(self, q: NDArray[np.float64], engine: _core.Simulator | None) -> None:
        """Raise SceneError where a velocity does not come back from its momentum, M(q)^-1 (M(q) w) != w."""
        dof, lost = (self.core if engine is None else engine).lost_velocity(q)
        if lost <= MOST_LOST:
            return
        name = dof_joint(self.built.model, dof)
        raise SceneError(
            "The mass matrix is singular at the start: a motion there has no inertia, and its velocity no meaning",
            joint=name,
            expected=f"velocities that come back from their momenta to {MOST_LOST:g}",
            got=f"{lost:.2g} off, most at joint {name!r}",
            remedy=f"Start from another pose, or give inertia: set_joint({name!r}, armature=1e-4)",
        )

    def _check_derivatives(self, q: NDArray[np.float64], v: NDArray[np.float64], t: float) -> None:
        """Check the user's derivatives at (q, v) and beside it: much vanishes at a start such as neutral."""
        dofs, move = self.built.elements.dofs, mover(self.built.model)
        generic = np.sin(1.0 + np.arange(len(v)))
        for element in self._scene.elements:
            if not getattr(element, "check", True):
                continue
            check_element(element, dofs, move, q, v + generic, t)
            if isinstance(element, (UserPotential, UserForce)):
                with contextlib.suppress(UserFunctionError):  # the function need not be defined there
                    check_element(element, dofs, move, move(q, GENERIC * generic), v + generic, t)


def _refuse_missing(scene: Scene) -> None:
    missing = scene.missing
    if missing:
        raise SceneError(
            f"The scene lacks {', '.join(repr(name) for name in missing)}",
            expected="every element that the stored scene had",
            got="elements given by Python functions, which files do not hold",
            remedy="Add them again under their names (a surface: scene.set_surface), or take them out: "
            "scene.remove(name)",
        )


def checked_scene(scene: Any) -> Scene:
    """Return a scene; raise InputError for anything else."""
    if not isinstance(scene, Scene):
        raise InputError(
            "Argument scene", name="scene", expected="a Scene", got=short(scene),
            remedy="Make one with contactvi.Scene() or contactvi.load_scene(path)",
        )  # fmt: skip
    return scene


def filled_scene(scene: Any) -> Scene:
    """Return a scene with something in it; raise InputError for an empty one, whose run would tell nothing."""
    checked = checked_scene(scene)
    if checked.parts or checked.nv:
        return checked
    raise InputError(
        "The scene is empty", name="scene", expected="at least one body", got="no parts",
        remedy='Add some: scene.add_sphere("ball", radius=0.1, placement=(0, 0, 1)), scene.add_urdf(path), ...;'
        " scene.add_halfspace() is the ground",
    )  # fmt: skip


def compile_scene(scene: Scene) -> CompiledScene:
    """Return the scene as its runs need it; it is kept with the scene until that is edited."""
    kept = checked_scene(scene).compiled
    if not isinstance(kept, CompiledScene) or not kept.fits(scene):
        kept = scene.compiled = CompiledScene(scene)
    return kept
