"""Many environments in one process, whose simulators are stepped side by side by threads of the engine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from contactvi.errors import InputError, SimulationError, did_you_mean
from contactvi.gym.environment import Observation, SceneEnv, StepResult, step_all
from contactvi.gym.hand import HandBallEnv
from contactvi.gym.leg import LegStandEnv
from contactvi.gym.quadruped import QuadrupedStandEnv
from contactvi.inputs import count, short
from contactvi.threads import Workers

Flags = NDArray[np.bool_]
Floats = NDArray[np.float64]


class ThreadedVectorEnv(VectorEnv[Observation, Observation, Any]):
    """Environments stepped in threads, each with the bits that it has alone, whatever the number of threads.

    Seeds, autoreset modes and infos are those of gymnasium.vector.SyncVectorEnv.

    Args:
        make: returns an environment. num_envs: how many there are.
        workers: number of threads; None for one per core.
        autoreset_mode: what happens to an environment whose episode has ended, by default NEXT_STEP: the next step
            resets it, whatever its action. SAME_STEP resets it at once: infos["final_obs"], infos["final_info"].
            DISABLED leaves it to reset(options={"reset_mask": ...}).

    Attributes:
        envs: the environments.
        workers: number of threads.

    Raises:
        InputError: for a bad argument.
    """

    envs: Sequence[SceneEnv] = ()

    def __init__(
        self,
        make: Callable[[], SceneEnv],
        num_envs: int,
        *,
        workers: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
    ) -> None:
        self.num_envs = count("num_envs", num_envs)
        self._mode = _mode(autoreset_mode)
        self.envs = tuple(make() for _ in range(self.num_envs))
        first = self.envs[0]
        if first.render_mode == "human" and self.num_envs > 1:
            raise InputError(
                "Live views of many environments", name="render_mode", expected="None | 'rgb_array' | 'ansi'",
                got="'human'", remedy="Show one with gymnasium.make(name, render_mode='human')",
            )  # fmt: skip
        self.metadata = {**first.metadata, "autoreset_mode": self._mode}
        self.render_mode = first.render_mode
        self.single_observation_space, self.single_action_space = first.observation_space, first.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.workers = Workers(workers).number
        self._ended: Flags = np.ones(self.num_envs, dtype=bool)  # waits for a reset
        self._begun = False
        self._seen = np.zeros(self.observation_space.shape or (), np.float32)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Start all episodes, or those of options["reset_mask"] (n,); seeds (n,), or one: seed, seed + 1, ...

        Raises:
            InputError: for seeds or a mask of another length.
        """
        seeds = self._seeds(seed)
        own = dict(options or {})
        mask = self._mask(own.pop("reset_mask", None))
        chosen = [k for k in range(self.num_envs) if mask[k]]
        infos: dict[str, Any] = {}
        for k in chosen:
            self._seen[k], info = self.envs[k].reset(seed=seeds[k], options=own)
            infos = self._add_info(infos, info, k)
        self._ended[chosen] = False
        self._begun = True
        return self._seen.copy(), infos

    def step(self, actions: Any) -> tuple[Observation, Floats, Flags, Flags, dict[str, Any]]:
        """Make a step of every environment; actions (n, ...). Return their observations, rewards, ... and infos.

        Raises:
            InputError: for actions of another shape, and with DISABLED for an environment that has not been reset.
            SimulationError: before `reset`.
        """
        values = np.asarray(actions)
        if values.shape[:1] != (self.num_envs,):
            raise InputError(
                "Actions", name="actions", expected=f"an array of shape {self.action_space.shape}",
                got=short(actions), remedy="Take envs.action_space.sample() as an example",
            )  # fmt: skip
        if not self._begun:
            raise SimulationError(
                "No episode has begun", expected="environments that have been reset", got="none",
                remedy="Call envs.reset(seed=1) first",
            )  # fmt: skip
        if self._mode == AutoresetMode.DISABLED and self._ended.any():
            raise InputError(
                "An episode has ended", name="actions", expected="environments whose episodes go on",
                got=f"that of environment {int(np.flatnonzero(self._ended)[0])} has ended",
                remedy="Call reset(options={'reset_mask': mask}) with the environments that have to start again",
            )  # fmt: skip
        going = [k for k in range(self.num_envs) if not self._ended[k]]
        stepped = step_all([self.envs[k] for k in going], [values[k] for k in going], self.workers) if going else []
        results = dict(zip(going, stepped, strict=True))
        found = [self._result(k, results.get(k)) for k in range(self.num_envs)]
        seen, rewards, terminated, truncated, each = zip(*found, strict=True)
        infos: dict[str, Any] = {}
        for k, info in enumerate(each):
            infos = self._add_info(infos, info, k)
        self._seen = np.stack(seen)
        ends = np.array(terminated), np.array(truncated)
        self._ended = np.zeros(self.num_envs, bool) if self._mode == AutoresetMode.SAME_STEP else ends[0] | ends[1]
        return self._seen.copy(), np.array(rewards), *ends, infos

    def _result(self, k: int, result: StepResult | None) -> StepResult:
        """Return the result of an environment, reset where its episode has ended; None: in the step before."""
        if result is None:
            seen, info = self.envs[k].reset()
            return seen, 0.0, False, False, info
        seen, reward, terminated, truncated, info = result
        if (terminated or truncated) and self._mode == AutoresetMode.SAME_STEP:
            final = {"final_obs": seen, "final_info": info}
            seen, info = self.envs[k].reset()
            info = {**info, **final}
        return seen, reward, terminated, truncated, info

    def render(self) -> tuple[Any, ...] | None:
        """Return what the environments render."""
        return None if self.render_mode is None else tuple(env.render() for env in self.envs)

    def close_extras(self, **kwargs: Any) -> None:
        """Close the environments."""
        for env in self.envs:
            env.close()

    def _seeds(self, seed: Any) -> list[int | None]:
        if seed is None or isinstance(seed, (int, np.integer)):
            return [None if seed is None else int(seed) + k for k in range(self.num_envs)]
        seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise InputError(
                "Seeds", name="seed", expected=f"one number, or {self.num_envs}", got=f"{len(seeds)} of them",
                remedy="Give one seed: the environments then get seed, seed + 1, ...",
            )  # fmt: skip
        return seeds

    def _mask(self, mask: Any) -> Flags:
        if mask is None:
            return np.ones(self.num_envs, bool)
        values = np.asarray(mask)
        if values.shape != (self.num_envs,) or values.dtype != bool or not values.any():
            raise InputError(
                "Mask of a reset", name="reset_mask", expected=f"{self.num_envs} booleans, one of them True",
                got=short(mask), remedy="Give terminated | truncated of the last step",
            )  # fmt: skip
        return values


def hand_balls(num_envs: int = 1, **options: Any) -> ThreadedVectorEnv:
    """Return HandBallEnv in threads; options of it and of ThreadedVectorEnv."""
    return _in_threads(HandBallEnv, num_envs, **options)


def standing_legs(num_envs: int = 1, **options: Any) -> ThreadedVectorEnv:
    """Return LegStandEnv in threads; options of it and of ThreadedVectorEnv."""
    return _in_threads(LegStandEnv, num_envs, **options)


def standing_quadrupeds(num_envs: int = 1, **options: Any) -> ThreadedVectorEnv:
    """Return QuadrupedStandEnv in threads; options of it and of ThreadedVectorEnv."""
    return _in_threads(QuadrupedStandEnv, num_envs, **options)


def _in_threads(
    env: Callable[..., SceneEnv],
    num_envs: int,
    workers: int | None = None,
    autoreset_mode: Any = AutoresetMode.NEXT_STEP,
    **options: Any,
) -> ThreadedVectorEnv:
    return ThreadedVectorEnv(lambda: env(**options), num_envs, workers=workers, autoreset_mode=autoreset_mode)


def make_vec(name: str, num_envs: int, *, workers: int | None = None, **kwargs: Any) -> ThreadedVectorEnv:
    """Return environments by their name, stepped in threads: as gymnasium.make_vec(name, num_envs).

    Args:
        name: "contactvi/HandBall-v0", ...
        num_envs: how many. workers: number of threads; None for one per core.
        **kwargs: autoreset_mode, see ThreadedVectorEnv; and those of the environment.

    Raises:
        InputError: for another name, and for bad arguments.
    """
    known = [key for key in gymnasium.registry if key.startswith("contactvi/")]
    if name not in known:
        raise InputError(
            f"There is no environment {name!r}", name="name", expected=" | ".join(known), got=short(name),
            remedy=did_you_mean(str(name), known),
        )  # fmt: skip
    found = gymnasium.make_vec(name, num_envs, vectorization_mode="vector_entry_point", workers=workers, **kwargs)
    assert isinstance(found, ThreadedVectorEnv)
    return found


def _mode(mode: Any) -> AutoresetMode:
    try:
        return AutoresetMode(mode)
    except ValueError:
        modes = [known.value for known in AutoresetMode]
        raise InputError(
            f"There is no autoreset mode {mode!r}", name="autoreset_mode", expected=" | ".join(modes), got=short(mode),
            remedy=did_you_mean(str(mode), modes),
        ) from None  # fmt: skip
