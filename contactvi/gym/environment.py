"""What the environments have in common: a scene driven by actions, the targets of servos or torques."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from contactvi.errors import InputError, SimulationError, did_you_mean
from contactvi.inputs import array, check_choice, count, positive, real, short
from contactvi.scene.scene import Scene
from contactvi.simulation.simulator import Simulator
from contactvi.simulation.together import step_together
from contactvi.status import Status

if TYPE_CHECKING:
    from contactvi.playback.live import LiveView
    from contactvi.playback.sketch import Sketch

Array = NDArray[np.float64]
Observation = NDArray[np.float32]
StepResult = tuple[Observation, float, bool, bool, dict[str, Any]]

ACTIONS = ("target", "torque")
DT, FRAME = 2e-3, 10  # of a step [s], steps between two actions
MOST = 100.0  # of what is observed [m, m/s, rad, rad/s]: spaces have to be bounded
RENDER_MODES = ["human", "rgb_array", "ansi"]


class SceneEnv(gymnasium.Env[Observation, Observation]):
    """A scene as an environment of Gymnasium.

    An action has a number in [-1, 1] for each servo: how far its target is from a nominal one, over the largest such
    distance. With actions="torque" it has one for each joint with one degree of freedom, in the order of v, or for
    each of `joints`: how far the torque is from a nominal one. It holds for a frame of some steps, by default 20 ms in
    ten; numbers beyond the range are cut, and those of observations at +-100. Episodes of equal seeds and actions have
    equal bits.

    An episode is truncated after `duration`, and where the engine finds no way on. Each `info` has "time" [s] and
    "status", "SUCCESS" or why the engine has ended the run (`StatusCode`).

    Args:
        scene: with servos where actions are their targets; it is not changed.
        nominal: targets of the servos where the action is zero, shape (n,) [rad or m], or torques [N m or N].
        reach: largest distances of the targets, or torques, from them, shape (n,).
        observed: how many numbers an observation has.
        duration: of an episode [s].
        actions: "target" of the servos (`Scene.servo_joints`), or "torque".
        joints: of actions="torque", those that are driven, by name or pattern, in this order; None: all with one degree
            of freedom. Targets go to all servos.
        dt: of a step [s]. frame: number of steps between two actions.
        record: what the simulator records (`Options.record`); True: all of an episode, so that
            `env.unwrapped.simulator.trajectory()` has it, for example to_html("episode.html").
        render_mode: None; "rgb_array": pictures of `picture_size`, drawn by this process without a browser or a window;
            "human": the live view in the browser, in real time, one environment at a time; "ansi": a line of text. A
            picture takes longer than many steps; a recorded episode can be played and turned.

    Attributes:
        simulator: the scene as it is now.
        picture_size: width and height of pictures [pixels]; what is set before the first one holds.
        nominal: as given; an episode may have its own.
        frame: as given.

    Raises:
        InputError: for a bad argument.
    """

    picture_size = 480, 360
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
        actions: str = "target",
        joints: Sequence[str] | str | None = None,
        dt: float = DT,
        frame: int = FRAME,
    ) -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise InputError(
                f"There is no render mode {render_mode!r}", name="render_mode", got=short(render_mode),
                expected="None | " + " | ".join(map(repr, RENDER_MODES)),
                remedy=did_you_mean(str(render_mode), RENDER_MODES),
            )  # fmt: skip
        self.render_mode = render_mode
        self._sketch: Sketch | None = None
        self._live: LiveView | None = None
        self._prepared: tuple[Any, StepResult] | None = None  # of an action that was made with those of others
        check_choice("actions", actions, ACTIONS, "What actions are")
        self.simulator = Simulator(scene, dt, record="states" if record else False)
        self.frame, self._pushed = count("frame", frame), actions == "torque"
        names, self._dofs = _driven(scene, self._pushed, joints)
        self.nominal = array("nominal", nominal, (len(names),), f"a number for each of {', '.join(names)}")
        self._reach = reach = array("reach", reach, (len(names),), f"a number for each of {', '.join(names)}")
        span = dt * self.frame
        self.metadata = {**self.metadata, "render_fps": max(1, round(1.0 / span))}
        self._frames = round(positive("duration", duration, "the time of an episode in seconds") / span)
        self._nv = int(scene.nv)
        self.count, self.action = 0, np.zeros(len(reach))
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(reach),), np.float32)
        self.observation_space = gymnasium.spaces.Box(-MOST, MOST, (observed,), np.float32)

    # --- what an environment is ---------------------------------------------------------------------------------------

    @abstractmethod
    def start(self, options: dict[str, Any]) -> tuple[Array, Array]:
        """Draw an episode with `self.np_random`; return its start, q (nq,) and v (nv,), or None for the scene's."""

    @abstractmethod
    def observe(self, q: Array, v: Array) -> Array:
        """Return what is seen of a state, shape (observed,)."""

    @abstractmethod
    def judge(self, q: Array, v: Array) -> tuple[float, bool]:
        """Return the reward of the last frame, at whose end the state is q, v, and whether the episode has ended."""

    def push(self) -> Array | None:
        """Return the generalized force in the next frame, shape (nv,), or None."""
        return None

    # --- what Gymnasium asks for --------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; return the observation and the info. See the environment for its options."""
        super().reset(seed=seed)
        q, v = _pair(
            "start", self.start({} if options is None else options), "the start of an episode, q (nq,) and v (nv,)"
        )
        self.simulator.reset(q, v)
        self.count = 0
        self.action = np.zeros(len(self._reach))
        self._prepared = None
        if self.render_mode == "human":
            self._show()
        return self._seen(self.simulator.q, self.simulator.v), self._info(self.simulator.status)

    def step(self, action: Any) -> StepResult:
        """Go on by a frame; return observation, reward, terminated, truncated, info.

        Raises:
            InputError: for an action of another shape, or with numbers that are not finite.
            SimulationError: before `reset`, and after the engine found no way on.
        """
        if self._prepared is None:
            return step_all([self], [action], 1)[0]
        foreseen, result = self._prepared
        self._prepared = None
        if not np.array_equal(foreseen, action):
            raise InputError(
                "A wrapper changes actions in a way that was not foreseen", name="action",
                expected="an action that only gymnasium.ActionWrappers change", got=short(action),
                remedy="Step this environment alone: in stable_baselines3's DummyVecEnv",
            )  # fmt: skip
        return result

    def prepare(self, action: Any, result: StepResult) -> None:
        """Keep what the next `step` returns: that of an action that was made together with those of others."""
        self._prepared = action, result

    def begin(self, action: Any) -> tuple[Array, Array | None]:
        """Take an action; return what acts in the next frame: generalized force (nv,), targets of the servos (n,).

        None where the servos go where they go by default, as actions are torques.
        """
        self.action = self._checked(action)
        given = self.push()
        force = np.zeros(self._nv) if given is None else array("push", given, (self._nv,), "one generalized force")
        at = self.nominal + self._reach * self.action
        if not self._pushed:
            return force, at
        force[self._dofs] += at
        return force, None

    def end(self, status: Status) -> StepResult:
        """Return what `step` returns, after the simulator has made its steps."""
        self.count += 1
        if self.render_mode == "human":
            self._show()
        q, v = self.simulator.q, self.simulator.v
        reward, ended = _pair("judge", self.judge(q, v), "the reward of a frame, and whether the episode has ended")
        return (
            self._seen(q, v),
            real("the reward of judge", reward),
            bool(ended),
            self.count >= self._frames or not status.ok,
            self._info(status),
        )

    def render(self) -> Any:
        """Return a picture (height, width, 3), uint8, with "rgb_array"; a line of text with "ansi"; else None.

        Raises:
            SimulationError: for a picture before `reset`.
        """
        if self.render_mode == "rgb_array":
            return self._drawn()
        if self.render_mode != "ansi":
            return None
        numbers = np.array2string(self.simulator.q, precision=3, suppress_small=True, max_line_width=10**6)
        return f"t = {self.simulator.t:.2f} s, {self.simulator.impacts} impacts, q = {numbers}\n"

    def close(self) -> None:
        """Close the live view, if there is one."""
        if self._live is not None:
            self._live.close()
            self._live = None

    def _drawn(self) -> NDArray[np.uint8]:
        """Return the picture; the camera is placed at the first one."""
        from contactvi.playback.sketch import Sketch

        if self.simulator.status is None:
            raise SimulationError(
                "There is nothing to draw", expected="an episode that has begun", got="none",
                remedy="Call env.reset() first",
            )  # fmt: skip
        if self._sketch is None:
            self._sketch = Sketch(self.simulator.scene, self.simulator.q, size=self.picture_size)
        return self._sketch.draw(self.simulator.q)

    def _show(self) -> None:
        """Show the simulator as it is now in the live view, which is opened where there is none."""
        from contactvi.playback.viewer import view

        if self._live is None:
            self._live = view(self.simulator, realtime=True)
        self._live.sync()

    def _checked(self, action: Any) -> Array:
        values = np.asarray(action)
        if values.shape != self.action_space.shape or values.dtype.kind not in "fiu" or not np.isfinite(values).all():
            raise InputError(
                "Action", name="action", expected=f"finite numbers of shape {self.action_space.shape}",
                got=short(action), remedy="Take env.action_space.sample() as an example",
            )  # fmt: skip
        return np.clip(values.astype(np.float64), -1.0, 1.0)

    def _seen(self, q: Array, v: Array) -> Observation:
        shape = self.observation_space.shape or ()
        seen = array("observe", self.observe(q, v), shape, "what observe returns, as many numbers as observed= says",
                     f"Return {shape[0]} numbers from observe, or give another number as observed=")  # fmt: skip
        return np.clip(seen, -MOST, MOST).astype(np.float32)

    def _info(self, status: Status | None) -> dict[str, Any]:
        code = "SUCCESS" if status is None else status.code.name
        return {"time": self.simulator.t, "status": code}


def _pair(name: str, value: Any, meaning: str) -> tuple[Any, Any]:
    """Return the two things that a method of the environment has returned; InputError where it has returned others."""
    if isinstance(value, (tuple, list)) and len(value) == 2:
        return value[0], value[1]
    raise InputError(
        f"{name} returned something else", name=name, expected=f"a pair: {meaning}", got=short(value),
        remedy=f"End {name} with " + ("return q, v" if name == "start" else "return reward, ended"),
    )  # fmt: skip


def _driven(scene: Scene, pushed: bool, joints: Sequence[str] | str | None) -> tuple[list[str], list[int]]:
    """Return the joints that actions drive and their places in v; InputError where there are none.

    Args:
        joints: as given; None: all that can be driven.
    """
    model = scene.model
    single = [str(model.names[i]) for i in range(1, model.njoints) if model.nvs[i] == 1]
    names = single if pushed else scene.servo_joints
    if joints is not None:
        if not pushed:
            raise InputError(
                "Joints of actions that are targets", name="joints", expected='joints with actions="torque"',
                got=short(joints), remedy="Leave joints out: targets go to the joints of scene.set_servo",
            )  # fmt: skip
        chosen = [joints] if isinstance(joints, str) else list(joints)
        names = list(dict.fromkeys(name for selector in chosen for name in scene.names.select_joints(selector)))
        wrong = [name for name in names if name not in single]
        if wrong:
            raise InputError(
                f"Joint {wrong[0]!r} has several degrees of freedom", name="joints", expected="joints with one",
                got=repr(wrong[0]), remedy=did_you_mean(wrong[0], single),
            )  # fmt: skip
    if not names:
        raise InputError(
            "The scene has nothing that an action drives", name="scene",
            expected="joints with one degree of freedom" if pushed else "a scene with servos", got="none",
            remedy="Add a robot" if pushed else 'Call scene.set_servo(joint, kp, kd) first, or use actions="torque"',
        )  # fmt: skip
    return names, [int(model.idx_vs[model.getJointId(name)]) for name in names]


def step_all(envs: Sequence[SceneEnv], actions: Sequence[Any], workers: int | None) -> list[StepResult]:
    """Step environments of one kind side by side in threads; return what the `step` of each would have.

    Args:
        workers: number of threads; None for one per core.

    Raises:
        InputError: an action of another shape, or frames of unlike length.
    """
    frames = sorted({env.frame for env in envs})
    if len(frames) > 1:
        raise InputError(
            "Environments of unlike frames", name="frame", expected="as many steps in each",
            got=" and ".join(map(str, frames)), remedy="Step those of one kind together",
        )  # fmt: skip
    inputs = [env.begin(action) for env, action in zip(envs, actions, strict=True)]
    forces = np.array([force for force, _ in inputs])
    followed = [target for _, target in inputs if target is not None]
    targets = np.array(followed) if followed else None
    simulators = [env.simulator for env in envs]
    statuses = step_together(simulators, frames[0], forces if forces.any() else None, targets, workers)
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
