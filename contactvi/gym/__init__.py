"""Environments of Gymnasium on hard contact, and many of them stepped in the engine's threads.

    import gymnasium
    import contactvi.gym  # registers the environments

    env = gymnasium.make("contactvi/HandBall-v0")
    envs = contactvi.gym.make_vec("contactvi/QuadrupedStand-v0", 64)

`gymnasium.make("contactvi.gym:contactvi/HandBall-v0")` needs no import. Gymnasium is needed: pip install
"contactvi[gym]".
"""

from __future__ import annotations

from contactvi.errors import missing_package

try:
    import gymnasium
except ImportError:
    raise missing_package("Gymnasium", "gym") from None

from contactvi.gym.environment import SceneEnv
from contactvi.gym.hand import HandBallEnv
from contactvi.gym.leg import LegStandEnv
from contactvi.gym.quadruped import QuadrupedStandEnv
from contactvi.gym.vector import ThreadedVectorEnv, make_vec

for _name, _env, _several in (
    ("HandBall-v0", "hand:HandBallEnv", "vector:hand_balls"),
    ("LegStand-v0", "leg:LegStandEnv", "vector:standing_legs"),
    ("QuadrupedStand-v0", "quadruped:QuadrupedStandEnv", "vector:standing_quadrupeds"),
):
    gymnasium.register(
        f"contactvi/{_name}",
        entry_point=f"contactvi.gym.{_env}",
        vector_entry_point=f"contactvi.gym.{_several}",
    )

__all__ = ["HandBallEnv", "LegStandEnv", "QuadrupedStandEnv", "SceneEnv", "ThreadedVectorEnv", "make_vec"]
