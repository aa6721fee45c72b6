"""Stable-Baselines3 with environments of contactvi, and the examples of learning: with the real packages."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import contactvi as cvi
import contactvi.gym
from helpers.extras import extra

torch = extra("torch")
sb3 = extra("stable_baselines3")
from stable_baselines3.common.env_util import make_vec_env  # noqa: E402
from stable_baselines3.common.monitor import Monitor  # noqa: E402
from stable_baselines3.common.vec_env import DummyVecEnv  # noqa: E402

from contactvi.gym.stable_baselines import ThreadedVecEnv  # noqa: E402

NAMES = ("contactvi/HandBall-v0", "contactvi/LegStand-v0", "contactvi/QuadrupedStand-v0")
LEG = NAMES[1]
EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "learning"


def numbers(env, steps: int, seed: int = 3) -> list[object]:
    """All that a VecEnv returns in some steps of drawn actions, but for times of the clock."""
    env.seed(seed)
    random = np.random.default_rng(0)
    low, high = env.action_space.low, env.action_space.high
    found: list[object] = [env.reset()]
    for _ in range(steps):
        shape = (env.num_envs, *env.action_space.shape)
        seen, rewards, ended, infos = env.step(random.uniform(low, high, shape).astype(np.float32))
        for info in infos:
            info.get("episode", {}).pop("t", None)
        found += [seen, rewards, ended, *(value for info in infos for _, value in sorted(info.items()))]
    return found


def assert_equal(a: list[object], b: list[object]) -> None:
    assert len(a) == len(b)
    for left, right in zip(a, b, strict=True):
        np.testing.assert_equal(left, right)


@pytest.mark.parametrize("name", NAMES)
def test_every_number_is_that_of_a_dummy_vec_env(name):
    """Episodes end in falls and by the time; Monitor adds its sums, and the last observation of an episode is told."""
    options = {"duration": 0.3, **({} if "Hand" in name else {"push": 60.0})}
    found = [
        numbers(make_vec_env(name, 3, env_kwargs=options, vec_env_cls=kind), 40)
        for kind in (DummyVecEnv, ThreadedVecEnv)
    ]
    assert_equal(*found)
    assert any(isinstance(entry, dict) and {"r", "l"} <= entry.keys() for entry in found[0])


def rescaled(env):
    return gymnasium.wrappers.RescaleAction(env, np.float32(-3.0), np.float32(3.0))


class Halved(gymnasium.Wrapper):
    """Changes actions without being an ActionWrapper."""

    def step(self, action):
        return self.env.step(0.5 * action)


def test_wrappers_of_actions_do_what_they_do_elsewhere():
    options = {"env_kwargs": {"duration": 0.2}, "wrapper_class": rescaled}
    a, b = (numbers(make_vec_env(LEG, 2, vec_env_cls=kind, **options), 15) for kind in (DummyVecEnv, ThreadedVecEnv))
    assert_equal(a, b)
    envs = make_vec_env(LEG, 2, wrapper_class=Halved, vec_env_cls=ThreadedVecEnv)
    envs.reset()
    with pytest.raises(cvi.InputError, match="was not foreseen.*DummyVecEnv"):
        envs.step(np.ones((2, 3), np.float32))


def test_what_make_vec_returns_is_taken():
    envs = ThreadedVecEnv(gymnasium.make_vec(LEG, 3, duration=0.2, workers=2))
    singles = DummyVecEnv([lambda: Monitor(gymnasium.make(LEG, duration=0.2))] * 3)
    assert_equal(numbers(envs, 25), numbers(singles, 25))
    assert envs.env_is_wrapped(Monitor) == [True] * 3


def test_other_environments_are_refused():
    with pytest.raises(cvi.InputError, match="not stepped by the engine"):
        ThreadedVecEnv([lambda: gymnasium.make("CartPole-v1")])
    with pytest.raises(cvi.InputError, match="workers"):
        make_vec_env(LEG, 2, vec_env_cls=ThreadedVecEnv, vec_env_kwargs={"workers": -1})


def test_a_name_is_enough():
    model = sb3.PPO("MlpPolicy", LEG, n_steps=32, batch_size=32, device="cpu", seed=0)
    before = [parameter.detach().clone() for parameter in model.policy.parameters()]
    model.learn(64)
    assert any((a != b).any() for a, b in zip(before, model.policy.parameters(), strict=True))
    assert model.get_env().render(mode="rgb_array").shape == (360, 480, 3)


@pytest.mark.skipif(not EXAMPLES.is_dir(), reason="the tests were copied without the examples")
@pytest.mark.parametrize(
    ("script", "short"),
    [("stand.py", ["--steps", "4096", "--curve", "c.png"]), ("ppo.py", ["--rounds", "2"]),
     ("rl_games_stand.py", ["--epochs", "2"])],
)  # fmt: skip
def test_examples_learn(script, short, tmp_path):
    """A few rounds: that every part of the loop works, and that a return is told. Learning takes minutes."""
    if "rl_games" in script:
        pytest.importorskip("rl_games")
    path = os.pathsep.join(p for p in sys.path if p)
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / script), *short], cwd=tmp_path, capture_output=True, text=True, timeout=300,
        env=dict(os.environ, PYTHONPATH=path),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert 30.0 < float(re.findall(r"return +([\d.]+)", done.stdout)[-1]) <= 200.0
    assert {p.name for p in tmp_path.iterdir()} == ({"c.png"} if script == "stand.py" else set())
    assert len((EXAMPLES / script).read_text().splitlines()) <= 125
