"""The environments of contactvi.gym: Gymnasium's own checks, seeds, rewards, endings, errors."""

from __future__ import annotations

import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env

import contactvi as cvi
import contactvi.gym
from contactvi.gym import hand, quadruped
from contactvi.gym.environment import DT, FRAME, SceneEnv
from helpers.commands import environment

NAMES = ("contactvi/HandBall-v0", "contactvi/QuadrupedStand-v0", "contactvi/LegStand-v0")


def make(name: str, **options: object) -> SceneEnv:
    env = gymnasium.make(name, **options).unwrapped
    assert isinstance(env, SceneEnv)
    return env


def roll(env: SceneEnv, actions: np.ndarray, seed: int | None = 3) -> list[np.ndarray]:
    """Return all numbers of an episode."""
    found = [env.reset(seed=seed)[0]]
    for action in actions:
        seen, reward, terminated, truncated, info = env.step(action)
        found.append(np.concatenate([seen, [reward, terminated, truncated, info["time"]], env.simulator.q]))
    return found


def drawn(env: SceneEnv, count: int, seed: int = 0) -> np.ndarray:
    shape = (count, *env.action_space.shape)
    return np.random.default_rng(seed).uniform(-1.0, 1.0, shape).astype(np.float32)


@pytest.mark.parametrize("name", NAMES)
def test_gymnasium_has_nothing_to_say(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for mode in (None, "ansi", "rgb_array"):
            check_env(make(name, render_mode=mode))
        gymnasium.make(name).reset(seed=0)


def test_a_name_with_its_module_needs_no_import(tmp_path):
    code = "import gymnasium; print(gymnasium.make('contactvi.gym:contactvi/HandBall-v0').action_space)"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment(), capture_output=True, text=True, timeout=120
    )
    assert "Box(-1.0, 1.0, (19,), float32)" in done.stdout, done.stderr


@pytest.mark.parametrize("name", NAMES)
def test_what_gymnasium_knows_of_it_can_be_stored(name):
    spec = EnvSpec.from_json(gymnasium.make(name, duration=1.0).spec.to_json())
    assert gymnasium.make(spec).unwrapped._frames == 50
    assert isinstance(gymnasium.make_vec(spec, 2), contactvi.gym.ThreadedVectorEnv)


@pytest.mark.parametrize("name", NAMES)
def test_equal_seeds_give_equal_bits(name):
    """Of a used environment, of a new one, and after other episodes."""
    env = make(name)
    actions = drawn(env, 30)
    first = roll(env, actions)
    roll(env, drawn(env, 7, seed=5), seed=11)
    for again in (roll(env, actions), roll(make(name), actions)):
        for a, b in zip(first, again, strict=True):
            np.testing.assert_array_equal(a, b)
    other = roll(env, actions, seed=4)
    assert not np.array_equal(first[0], other[0])


@pytest.mark.parametrize("name", NAMES)
def test_an_episode_lasts_as_long_as_it_should(name):
    options = {} if "Hand" in name else {"push": 0.0}
    env = make(name, duration=0.2, **options)
    env.reset(seed=0)
    zero = np.zeros(env.action_space.shape, np.float32)
    ends = [env.step(zero)[2:] for _ in range(10)]
    assert [truncated for _, truncated, _ in ends] == [False] * 9 + [True]
    assert not any(terminated for terminated, _, _ in ends)
    assert ends[-1][2]["time"] == pytest.approx(0.2, abs=1e-12)
    assert ends[-1][2]["status"] == "SUCCESS"


def test_the_ball_stays_where_it_is_put():
    """The servos hold the hand and the weight of the ball; the reward is that of the distance."""
    env = make(NAMES[0])
    env.reset(seed=0, options={"place": (-0.05, 0.01), "wanted": (-0.05, 0.01)})
    for _ in range(50):
        seen, reward, *_ = env.step(np.zeros(19, np.float32))
    assert seen[38:40] == pytest.approx([-0.05, 0.01], abs=1e-3)
    assert reward == pytest.approx(1.0, abs=5e-3)
    env.reset(seed=0, options={"place": (-0.05, 0.01), "wanted": (-0.05 + hand.NEAR, 0.01)})
    assert env.step(np.zeros(19, np.float32))[1] == pytest.approx(np.exp(-1.0), abs=1e-3)
    assert env.step(np.full(19, 1.0, np.float32))[1] < np.exp(-1.0)  # actions cost


def test_the_ball_is_free_wherever_it_starts():
    """It lies on the palm, and touches nothing else."""
    env = make(NAMES[0])
    scene = env.simulator.scene
    pairs = np.arange(len(scene.pair_names))
    palm = [k for k, pair in enumerate(scene.pair_names) if "palm" in pair[0] + pair[1]]
    for x in np.linspace(hand.LOWEST[0], hand.HIGHEST[0], 5):
        for y in np.linspace(hand.LOWEST[1], hand.HIGHEST[1], 5):
            env.reset(options={"place": (x, y)})
            gaps = scene.core().gaps_along(env.simulator.q[None], pairs)[0]
            assert 0.0 <= gaps[palm].min() < 1e-4
            assert np.delete(gaps, palm).min() > 2e-3


def test_a_lost_ball_ends_the_episode():
    env = make(NAMES[0])
    env.reset(seed=0)
    action = np.zeros(19, np.float32)
    action[2] = 1.0  # the palm rolls to one side
    ended = False
    for _ in range(200):
        _, _, ended, truncated, _ = env.step(action)
        if ended or truncated:
            break
    assert ended
    assert env.simulator.q[21] < hand.HEIGHT - hand.LOST


def test_the_robot_stands_with_its_weight_on_its_feet():
    env = make(NAMES[1], push=0.0)
    env.reset(seed=0)
    for _ in range(100):
        seen, reward, *_ = env.step(np.zeros(12, np.float32))
    force = sum(contact.force for contact in env.simulator.contacts)
    assert np.abs(force[2]) == pytest.approx(2.5 * 9.81, rel=1e-2)
    assert len({contact.pair for contact in env.simulator.contacts}) == 4
    assert seen[1:4] == pytest.approx([0.0, 0.0, 1.0], abs=0.05)
    assert 0.95 < reward <= 1.0


def test_a_push_has_its_impulse():
    """In the air, that is before the feet have touched: the momentum of the whole robot changes by the impulse."""
    env = make(NAMES[1], push=2.0)
    env.reset(seed=1)
    env._plan(0)
    env._next = 0
    env.simulator.reset(env._stance + np.r_[0.0, 0.0, 1.0, np.zeros(16)], np.zeros(18))
    for _ in range(quadruped.PUSH_FRAMES):
        env.step(np.zeros(12, np.float32))
    import pinocchio as pin

    model = env.simulator.scene.model
    momentum = pin.computeCentroidalMomentum(model, model.createData(), env.simulator.q, env.simulator.v).linear
    wanted = env._force * quadruped.PUSH_FRAMES * FRAME * DT
    assert 0.0 < np.linalg.norm(wanted) <= 2.0
    assert momentum[:2] == pytest.approx(wanted, rel=2e-2)  # the force keeps its direction in the base for 20 ms


def test_a_fall_ends_the_episode():
    env = make(NAMES[1], push=60.0)
    env.reset(seed=0)
    for _ in range(250):
        _, _, ended, _, _ = env.step(np.zeros(12, np.float32))
        if ended:
            break
    assert ended
    assert env.simulator.t < 5.0


@pytest.mark.parametrize("name", NAMES)
def test_an_episode_can_be_played(name, tmp_path):
    env = make(name, record=True, render_mode="ansi")
    env.reset(seed=0)
    for _ in range(5):
        env.step(np.zeros(env.action_space.shape, np.float32))
    traj = env.simulator.trajectory()
    assert traj.t[-1] == pytest.approx(5 * FRAME * DT, abs=1e-12)
    assert traj.to_html(tmp_path / "episode.html").is_file()
    assert env.render().startswith("t = 0.10 s")
    with pytest.raises(cvi.SimulationError, match="record"):
        make(name).simulator.trajectory()


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: contactvi.gym.HandBallEnv(render_mode="rgb_aray"), "render mode 'rgb_aray'.*Did you mean 'rgb_array'"),
        (lambda: contactvi.gym.HandBallEnv(duration=-1.0), "duration"),
        (lambda: contactvi.gym.QuadrupedStandEnv(push=-1.0), "push"),
        (lambda: make(NAMES[0]).reset(options={"place": (1.0,)}), "place"),
    ],
)
def test_bad_arguments(call, says):
    with pytest.raises(cvi.InputError, match=says):
        call()


@pytest.mark.parametrize("action", [np.zeros(3), np.full(19, np.nan), "a", None, np.zeros((1, 19))])
def test_bad_actions(action):
    env = make(NAMES[0])
    env.reset(seed=0)
    with pytest.raises(cvi.InputError, match="Action"):
        env.step(action)


def test_actions_beyond_the_range_are_cut():
    env = make(NAMES[0])
    ends = []
    for action in (np.full(19, 1.0, np.float32), np.full(19, 7.0, np.float32)):
        env.reset(seed=0)
        ends.append(env.step(action)[0])
    np.testing.assert_array_equal(*ends)


def test_a_missing_gymnasium_is_told(tmp_path):
    (tmp_path / "gymnasium.py").write_text("raise ImportError('missing')")
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import contactvi.gym"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert 'pip install "contactvi[gym]"' in done.stderr


# -- environments of one's own ----------------------------------------------------------------------------------------


class Pendulum(SceneEnv):
    """A pendulum without servos, or with one."""

    def __init__(self, servo: bool = False, numbers: int = 2, **options: object) -> None:
        scene = cvi.Scene()
        scene.add_urdf("models/damped_pendulum.urdf")
        scene.add_sphere("ball", 0.1, placement=(5.0, 0.0, 0.0))
        if servo:
            scene.set_servo("hinge", kp=50.0, kd=5.0)
        self.numbers = numbers
        options = {"nominal": np.zeros(1), "reach": np.full(1, 2.0), "observed": 2, "duration": 1.0} | options
        super().__init__(scene, **options)  # type: ignore[arg-type]

    def start(self, options):
        return self.simulator.scene.neutral(), np.zeros(self.simulator.scene.nv)

    def observe(self, q, v):
        return np.zeros(self.numbers)

    def judge(self, q, v):
        return 0.0, False


def test_torques_are_those_of_a_simulator():
    env = Pendulum(actions="torque", dt=1e-3, frame=7)
    assert env.metadata["render_fps"] == 143
    env.reset(seed=1)
    sim = cvi.Simulator(env.simulator.scene, dt=1e-3)
    sim.reset(env.simulator.q, env.simulator.v)
    for action in (0.5, -0.25):
        env.step(np.array([action]))
        tau = np.zeros(sim.scene.nv)
        tau[sim.scene.v_index("hinge")] = 2.0 * action
        sim.run(7, tau)
        np.testing.assert_array_equal(env.simulator.q, sim.q)
    assert env.simulator.t == pytest.approx(14e-3)


def test_torques_of_named_joints():
    """A cart on a rail with a pole: the cart is driven, the pole is not, and actions have one number."""

    class Cart(Pendulum):
        def __init__(self, **options: object) -> None:
            scene = cvi.Scene()
            scene.add_urdf("models/cart_pendulum.urdf")
            self.numbers = 2
            options = {"nominal": [0.0], "reach": [10.0], "observed": 2, "duration": 1.0} | options
            SceneEnv.__init__(self, scene, **options)  # type: ignore[arg-type]

    whole = Cart(actions="torque", joints="*", nominal=[0.0] * 2, reach=[1.0] * 2)
    cart, pole = list(whole.simulator.scene.model.names)[1:]
    env = Cart(actions="torque", joints=[cart])
    assert env.action_space.shape == (1,)
    env.reset(seed=1)
    sim = cvi.Simulator(env.simulator.scene, dt=2e-3)
    sim.reset(env.simulator.q, env.simulator.v)
    env.step(np.array([0.5]))
    tau = np.zeros(2)
    tau[sim.scene.v_index(cart)] = 5.0
    sim.run(10, tau)
    np.testing.assert_array_equal(env.simulator.q, sim.q)
    with pytest.raises(cvi.InputError, match="Unknown joint"):
        Cart(actions="torque", joints=["wheel"])
    with pytest.raises(cvi.InputError, match="Leave joints out"):
        Cart(actions="target", joints=[pole])


def test_torques_in_threads_have_the_bits_of_one():
    envs = contactvi.gym.ThreadedVectorEnv(lambda: Pendulum(actions="torque"), 3)
    envs.reset(seed=1)
    alone = Pendulum(actions="torque")
    alone.reset(seed=3)
    for k in range(5):
        envs.step(np.array([[0.3], [0.5], [0.1 * k]]))
        alone.step(np.array([0.1 * k]))
    np.testing.assert_array_equal(envs.envs[2].simulator.q, alone.simulator.q)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, 'expected a scene with servos, got none.*actions="torque"'),
        ({"servo": True, "nominal": np.zeros(3)}, "nominal has the wrong shape: .*hinge"),
        ({"servo": True, "reach": np.zeros(3)}, "reach has the wrong shape: .*hinge"),
        ({"servo": True, "actions": "torques"}, "Did you mean 'torque'"),
        ({"servo": True, "frame": 0}, "frame"),
        ({"servo": True, "dt": -1.0}, "dt"),
    ],
)
def test_what_cannot_be_an_environment_is_refused_when_it_is_made(options, message):
    with pytest.raises(cvi.InputError, match=message):
        Pendulum(**options)


def test_an_observation_of_another_shape_is_refused_by_name():
    with pytest.raises(cvi.InputError, match=r"observe has the wrong shape: .*shape \(2,\), got shape \(3,\)"):
        Pendulum(servo=True, numbers=3).reset(seed=1)


@pytest.mark.parametrize(
    ("method", "returned", "says"),
    [
        ("start", np.zeros(2), "return q, v"),
        ("judge", None, "return reward, ended"),
        ("judge", (1.0, False, {}), "return reward, ended"),
        ("judge", ("much", False), "the reward of judge is not usable"),
    ],
)
def test_what_a_method_of_an_environment_returns_is_checked(monkeypatch, method, returned, says):
    env = Pendulum(servo=True)
    monkeypatch.setattr(env, method, lambda *arguments: returned)
    if method == "judge":
        env.reset(seed=1)
    call = (lambda: env.reset(seed=1)) if method == "start" else (lambda: env.step(np.zeros(1)))
    with pytest.raises(cvi.InputError, match=says):
        call()


def test_a_start_of_nothing_is_that_of_the_scene(monkeypatch):
    env = Pendulum(servo=True)
    seen = []
    monkeypatch.setattr(env, "start", lambda options: (None, None))
    monkeypatch.setattr(env, "observe", lambda q, v: seen.append((q, v)) or np.zeros(2))
    env.reset(seed=1)
    np.testing.assert_array_equal(seen[0][0], env.simulator.scene.neutral())
    assert not seen[0][1].any()
