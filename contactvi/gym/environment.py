"""What the environments have in common: a scene whose servos follow the actions, observed every 20 ms."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from contactvi.errors import InputError
from contactvi.inputs import positive, short
from contactvi.scene.scene import Scene
from contactvi.simulation.simulator import Simulator
from contactvi.simulation.together import step_together
from contactvi.status import Status

Array = NDArray[np.float64]
Observation = NDArray[np.float32]

DT, FRAME = 2e-3, 10  # of a step [s], steps between two actions
MOST = 100.0  # of what is observed [m, m/s, rad, rad/s]: spaces have to be bounded
RENDER_MODES = ["ansi"]


class SceneEnv(gymnasium.Env[Observation, Observation]):
    """A scene with servos as an environment of Gymnasium.

    An action has a number in [-1, 1] for each servo: how far its target is from a nominal one, over the largest such
    distance. It holds for 20 ms, in which the engine makes ten steps; numbers beyond the range are cut, and those of
    observations at +-100. Episodes of equal seeds and actions have equal bits.

    An episode is truncated after `duration`, and where the engine finds no way on. Each `info` has "time" [s] and
    "status", "SUCCESS" or why the engine has ended the run (`StatusCode`).

    Args:
        scene: with servos; it is not changed.
        nominal: targets of the servos where the action is zero, shape (n,) [rad or m].
        reach: largest distances of the targets from them, shape (n,).
        observed: how many numbers an observation has.
        duration: of an episode [s].
        record: what the simulator records (`Options.record`); True: all of an episode, so that
            `env.unwrapped.simulator.trajectory()` has it, for example to_html("episode.html").
        render_mode: None, or "ansi": a line of text. A picture of a scene takes longer than many steps of it: record an
            episode, and play it.

    Attributes:
        simulator: the scene as it is now.
        nominal: as given; an episode may have its own.

    Raises:
        InputError: for a bad argument.
    """

    metadata = {"render_modes": RENDER_MODES, "render_fps": round(1.0 / (DT * FRAME))}

    def __init__(
        self,
        scene: Scene,
        nominal: Array,
        reach: Array,
        observed: int,
        *,
        duration: float,
        record: bool = False,
        render_mode: str | None = None,
    ) -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise InputError(
                f"There is no render mode {render_mode!r}", name="render_mode", expected="None | 'ansi'",
                got=short(render_mode), remedy="Use record=True and env.unwrapped.simulator.trajectory().to_html(path)",
            )  # fmt: skip
        self.render_mode = render_mode
        self.simulator = Simulator(scene, DT, record="states" if record else False)
        self.nominal, self._reach = nominal, reach
        self._frames = round(positive("duration", duration, "the time of an episode in seconds") / (DT * FRAME))
        self._nv = int(scene.nv)
        self.count, self.action = 0, np.zeros(len(reach))
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(reach),), np.float32)
        self.observation_space = gymnasium.spaces.Box(-MOST, MOST, (observed,), np.float32)

    # --- what an environment is ---------------------------------------------------------------------------------------

    @abstractmethod
    def start(self, options: dict[str, Any]) -> tuple[Array, Array]:
        """Draw an episode with `self.np_random`; return its start, q (nq,) and v (nv,)."""

    @abstractmethod
    def observe(self, q: Array, v: Array) -> Array:
        """Return what is seen of a state, shape (observed,)."""

    @abstractmethod
    def judge(self, q: Array, v: Array) -> tuple[float, bool]:
        """Return the reward of the last 20 ms, at whose end the state is q, v, and whether the episode has ended."""

    def push(self) -> Array | None:
        """Return the generalized force in the next 20 ms, shape (nv,), or None."""
        return None

    # --- what Gymnasium asks for --------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; return the observation and the info. See the environment for its options."""
        super().reset(seed=seed)
        q, v = self.start({} if options is None else options)
        self.simulator.reset(q, v)
        self.count = 0
        self.action = np.zeros(len(self._reach))
        return self._seen(q, v), self._info(self.simulator.status)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Go on by 20 ms; return observation, reward, terminated, truncated, info.

        Raises:
            InputError: for an action of another shape, or with numbers that are not finite.
            SimulationError: before `reset`, and after the engine found no way on.
        """
        return step_all([self], [action], 1)[0]

    def begin(self, action: Any) -> tuple[Array, Array]:
        """Take an action; return what acts in the next 20 ms: generalized force (nv,), targets of the servos (n,)."""
        self.action = self._checked(action)
        force = self.push()
        at = self.nominal + self._reach * self.action
        return np.zeros(self._nv) if force is None else force, at

    def end(self, status: Status) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Return what `step` returns, after the simulator has made its steps."""
        self.count += 1
        q, v = self.simulator.q, self.simulator.v
        reward, ended = self.judge(q, v)
        return self._seen(q, v), float(reward), ended, self.count >= self._frames or not status.ok, self._info(status)

    def render(self) -> str | None:
        """Return a line of text with render_mode="ansi", else None."""
        if self.render_mode is None:
            return None
        numbers = np.array2string(self.simulator.q, precision=3, suppress_small=True, max_line_width=10**6)
        return f"t = {self.simulator.t:.2f} s, {self.simulator.impacts} impacts, q = {numbers}\n"

    def _checked(self, action: Any) -> Array:
        values = np.asarray(action)
        if values.shape != self.action_space.shape or values.dtype.kind not in "fiu" or not np.isfinite(values).all():
            raise InputError(
                "Action", name="action", expected=f"finite numbers of shape {self.action_space.shape}",
                got=short(action), remedy="Take env.action_space.sample() as an example",
            )  # fmt: skip
        return np.clip(values.astype(np.float64), -1.0, 1.0)

    def _seen(self, q: Array, v: Array) -> Observation:
        return np.clip(self.observe(q, v), -MOST, MOST).astype(np.float32)

    def _info(self, status: Status | None) -> dict[str, Any]:
        code = "SUCCESS" if status is None else status.code.name
        return {"time": self.simulator.t, "status": code}


def step_all(
    envs: Sequence[SceneEnv], actions: Sequence[Any], workers: int | None
) -> list[tuple[Observation, float, bool, bool, dict[str, Any]]]:
    """Step environments with as many servos side by side in threads; return what the `step` of each would have.

    Args:
        workers: number of threads; None for one per core.
    """
    inputs = [env.begin(action) for env, action in zip(envs, actions, strict=True)]
    forces, targets = (np.array(rows) for rows in zip(*inputs, strict=True))
    simulators = [env.simulator for env in envs]
    statuses = step_together(simulators, FRAME, forces if forces.any() else None, targets, workers)
    return [env.end(status) for env, status in zip(envs, statuses, strict=True)]


def rotation(quaternion: Array) -> Array:
    """Return the rotation matrix (3, 3) of a quaternion x y z w."""
    x, y, z, w = quaternion
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )
