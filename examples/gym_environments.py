"""The environments of contactvi.gym with three policies, and many of them stepped side by side in threads.

"hold" does nothing: servos hold the hand, or the robot's stance. "random" draws every action. "tilt", of the hand
alone, tilts the palm by a linear law of what is missing and of the ball's speed. They show what a return means.

python examples/gym_environments.py [EPISODE.html] [--episodes 5]
"""

import argparse

import gymnasium
import numpy as np

import contactvi.gym

HAND, QUADRUPED = "contactvi/HandBall-v0", "contactvi/QuadrupedStand-v0"
RATE, DAMPING = 4.0, 0.8  # of the ball's motion to its place [rad/s], ratio
REACH = 0.15  # of pitch and roll at an action of 1 [rad]

parser = argparse.ArgumentParser()
parser.add_argument("page", nargs="?")
parser.add_argument("--episodes", type=int, default=5)
arguments = parser.parse_args()


def hold(env, seen):
    return np.zeros(env.action_space.shape, np.float32)


def tilt(env, seen):
    """A ball rolls down a slope with 5/7 of g sin(slope); the law makes that a spring and a damper."""
    speed, missing = seen[41:43], seen[44:46]
    along, across = (RATE**2 * missing - 2.0 * DAMPING * RATE * speed) / (5.0 / 7.0 * 9.81) / REACH
    action = hold(env, seen)
    action[1:3] = np.clip([along, -across], -1.0, 1.0)  # pitch, roll
    return action


def random(env, seen):
    return env.action_space.sample()


def episode(env, policy, seed):
    """Return the sum of the rewards, how long it was [s], and the observations."""
    env.action_space.seed(seed)
    observation, info = env.reset(seed=seed)
    total, seen, ended = 0.0, [observation], False
    while not ended:
        observation, reward, terminated, truncated, info = env.step(policy(env, observation))
        total, ended = total + reward, terminated or truncated
        seen.append(observation)
    return total, info["time"], np.array(seen)


means = {}
for name, policies in {HAND: (hold, random, tilt), QUADRUPED: (hold, random)}.items():
    env = gymnasium.make(name)
    for policy in policies:
        found = [episode(env, policy, seed)[:2] for seed in range(arguments.episodes)]
        means[name, policy.__name__] = total, span = np.mean(found, axis=0)
        print(f"{name:<28} {policy.__name__:<7} return {total:6.1f}, {span:.2f} s")
    first, again = (episode(env, policies[-1], seed=7)[2] for _ in range(2))
    print(f"{name:<28} the same episode twice: {'equal to the bit' if np.array_equal(first, again) else 'not equal'}")
    assert np.array_equal(first, again)

envs = contactvi.gym.make_vec(HAND, 8)
observations, infos = envs.reset(seed=7)
for _ in range(20):
    observations, rewards, terminated, truncated, infos = envs.step(np.zeros((8, 19), np.float32))
print(f"8 hands in threads, after {infos['time'][0]:.2f} s: rewards {np.array2string(rewards, precision=2)}")
envs.close()

if arguments.page:
    env = gymnasium.make(HAND, record=True)
    episode(env, tilt, seed=7)
    scene = env.unwrapped
    assert isinstance(scene, contactvi.gym.SceneEnv)
    print("episode:", scene.simulator.trajectory().to_html(arguments.page, overwrite=True))
assert means[HAND, "tilt"][0] > means[HAND, "hold"][0] > means[HAND, "random"][0]
assert means[QUADRUPED, "hold"][0] > means[QUADRUPED, "random"][0]
