"""Environments in threads: the bits of single ones, and the semantics of Gymnasium's own vector environments."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import contactvi as cvi
import contactvi.gym
from contactvi.gym.environment import SceneEnv

NAMES = ("contactvi/HandBall-v0", "contactvi/QuadrupedStand-v0", "contactvi/LegStand-v0")
MODES = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP]


def actions(number: int, width: int, count: int) -> np.ndarray:
    return np.random.default_rng(1).uniform(-1.0, 1.0, (count, number, width)).astype(np.float32)


def assert_equal(a: object, b: object) -> None:
    """Nested dictionaries, sequences and arrays are equal to the bit."""
    if isinstance(a, dict):
        assert isinstance(b, dict)
        assert a.keys() == b.keys()
        for key in a:
            assert_equal(a[key], b[key])
    elif isinstance(a, tuple) or (isinstance(a, np.ndarray) and a.dtype == object):
        assert len(a) == len(b)
        for left, right in zip(a, b, strict=True):
            assert_equal(left, right)
    else:
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("workers", [1, 2, 5])
def test_each_has_the_bits_of_a_single_one(name, workers):
    number = 5
    envs = contactvi.gym.make_vec(name, number, workers=workers)
    singles = [gymnasium.make(name) for _ in range(number)]
    seen, _ = envs.reset(seed=10)
    assert seen.shape == envs.observation_space.shape
    for k, env in enumerate(singles):
        np.testing.assert_array_equal(env.reset(seed=10 + k)[0], seen[k])
    for step in actions(number, envs.single_action_space.shape[0], 12):
        seen, rewards, terminated, truncated, infos = envs.step(step)
        for k, env in enumerate(singles):
            found = env.step(step[k])
            assert_equal((found[0], found[1:4]), (seen[k], (rewards[k], terminated[k], truncated[k])))
            assert {key: infos[key][k] for key in found[4]} == found[4]
    envs.close()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", NAMES)
def test_autoreset_is_that_of_gymnasium(name, mode):
    """Episodes end at different times, by their length and before; every number is that of a SyncVectorEnv."""
    options = {"duration": 0.5} if "Hand" in name else {"duration": 0.5, "push": 80.0}

    def make() -> gymnasium.Env:
        return gymnasium.make(name, **options)

    number = 3
    ours = contactvi.gym.make_vec(name, number, workers=2, autoreset_mode=mode, **options)
    theirs = SyncVectorEnv([make] * number, autoreset_mode=mode)
    assert ours.metadata["autoreset_mode"] == mode
    assert_equal(ours.reset(seed=3), theirs.reset(seed=3))
    ends = np.zeros(2, int)
    for step in actions(number, ours.single_action_space.shape[0], 60):
        found = ours.step(step)
        assert_equal(found, theirs.step(step))
        ends += [found[2].sum(), found[3].sum()]
    assert ends[1] >= number or "Hand" not in name
    assert ends.sum() >= number
    ours.close()
    theirs.close()


def test_reset_by_a_mask():
    envs = contactvi.gym.make_vec(NAMES[0], 3, duration=0.1, autoreset_mode="Disabled")
    envs.reset(seed=0)
    zero = np.zeros(envs.action_space.shape, np.float32)
    for _ in range(5):
        seen, _, terminated, truncated, _ = envs.step(zero)
    assert truncated.all()
    with pytest.raises(cvi.InputError, match="An episode has ended"):
        envs.step(zero)
    mask = np.array([True, False, True])
    fresh, infos = envs.reset(seed=[5, None, 6], options={"reset_mask": mask})
    np.testing.assert_array_equal(fresh[1], seen[1])
    assert list(infos["_time"]) == [True, False, True]
    np.testing.assert_array_equal(fresh[2], gymnasium.make(NAMES[0]).reset(seed=6)[0])
    with pytest.raises(cvi.InputError, match="environment 1 has ended"):
        envs.step(zero)
    envs.reset(options={"reset_mask": ~mask})
    envs.step(zero)


def test_what_was_returned_does_not_change():
    envs = contactvi.gym.make_vec(NAMES[0], 2)
    first, _ = envs.reset(seed=0)
    kept = first.copy()
    second = envs.step(np.ones(envs.action_space.shape, np.float32))[0]
    np.testing.assert_array_equal(first, kept)
    assert not np.array_equal(first, second)


def test_gymnasium_makes_the_same():
    envs = gymnasium.make_vec(NAMES[1], 2, push=0.0)
    assert isinstance(envs, contactvi.gym.ThreadedVectorEnv)
    assert isinstance(envs.envs[0], SceneEnv)
    assert envs.num_envs == 2
    assert envs.render() is None
    envs.close()


class Fails(contactvi.gym.HandBallEnv):
    """The third of its steps fails."""

    def judge(self, q, v):
        if self.count == 3:
            raise ZeroDivisionError("what a pity")
        return super().judge(q, v)


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_of_an_environment_comes_through(workers):
    envs = contactvi.gym.ThreadedVectorEnv(Fails, 3, workers=workers)
    envs.reset(seed=0)
    zero = np.zeros(envs.action_space.shape, np.float32)
    envs.step(zero)
    envs.step(zero)
    with pytest.raises(ZeroDivisionError, match="what a pity"):
        envs.step(zero)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: contactvi.gym.make_vec("contactvi/HandBal-v0", 2), "Did you mean"),
        (lambda: contactvi.gym.make_vec("CartPole-v1", 2), "There is no environment"),
        (lambda: contactvi.gym.make_vec(NAMES[0], 0), "num_envs"),
        (lambda: contactvi.gym.make_vec(NAMES[0], 2, workers=-1), "workers"),
        (lambda: contactvi.gym.make_vec(NAMES[0], 2, autoreset_mode="never"), "autoreset mode"),
        (lambda: contactvi.gym.make_vec(NAMES[0], 2).reset(seed=[1]), "Seeds"),
        (lambda: contactvi.gym.make_vec(NAMES[0], 2).reset(options={"reset_mask": [True]}), "Mask"),
        (lambda: contactvi.gym.make_vec(NAMES[0], 2).step(np.zeros((3, 19))), "Actions"),
    ],
)
def test_bad_arguments(call, says):
    with pytest.raises(cvi.InputError, match=says):
        call()


def test_a_step_before_the_first_reset_is_refused():
    envs = contactvi.gym.make_vec("contactvi/LegStand-v0", 2)
    with pytest.raises(cvi.SimulationError, match="Call envs.reset"):
        envs.step(np.zeros(envs.action_space.shape))
    envs.reset(seed=1)
    envs.step(np.zeros(envs.action_space.shape))
