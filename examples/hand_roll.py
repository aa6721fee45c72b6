"""The Allegro hand rolls a ball to a wanted place in its palm: 190 numbers of its servos' targets, by their gradient.

The scene and the variables are those of hand_throw.py; the ball stays in rolling contact with the palm. The cost asks
for the ball at rest in its new place, and the wrist where it began. The search begins with a hand that stands still.

python examples/hand_roll.py [playback.html]
"""

import sys

import numpy as np
from hand_control.scene import hand
from hand_control.shooting import DT, Shooting, at_rest, solve

SPAN = 1.0  # [s]
FROM, TO = (-0.065, 0.03), (-0.035, 0.0)  # of the ball in the palm, along the fingers and across [m]


def main() -> None:
    (scene, start, held), (_, wanted, held_there) = hand(FROM), hand(TO)
    steps = round(SPAN / DT)

    def cost(t: np.ndarray, q: np.ndarray, v: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        J, slope_q, slope_v = at_rest(q, v, wanted)  # ten times: the effort counts less than in a throw
        return 10.0 * J, 10.0 * slope_q, 10.0 * slope_v

    problem = Shooting(scene, start, np.linspace(held, held_there, steps), cost)
    traj = problem.run(solve(problem), hold=200)
    spins = np.linalg.norm(traj.v[:steps, 22:], axis=1).max()
    tilt = np.abs(traj.q[:steps, 1:3]).max()
    miss, speed = np.linalg.norm(traj.q[steps, 19:22] - wanted[19:22]), np.linalg.norm(traj.v[steps, 19:22])
    print(
        f"the wrist tilts by {tilt:.3f} rad at most, the ball turns with up to {spins:.2f} rad/s and rolls all the way"
    )
    print(f"at {SPAN} s {1e3 * miss:.2f} mm beside the wanted place, at {1e3 * speed:.2f} mm/s")
    assert len(traj.contact_changes) == 1  # it touches from the start on, sticks, and is never released
    assert spins > 1.0
    assert miss < 2e-3
    assert speed < 5e-3
    assert np.linalg.norm(traj.q[-1, 19:22] - wanted[19:22]) < 5e-3  # and stays, for 0.4 s more
    if len(sys.argv) > 1:
        traj.to_html(sys.argv[1], overwrite=True)


if __name__ == "__main__":
    main()
