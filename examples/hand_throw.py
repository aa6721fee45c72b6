"""The Allegro hand throws a ball and catches it again: 190 numbers of its servos' targets, by their exact gradient.

The hand lies palm up on a wrist that lifts, pitches and rolls; all 19 joints have servos. The variables are splines,
ten per joint, added to targets that hold the start. The cost asks for the ball's height at one time, and for ball and
wrist at rest where they began at the end. The search begins with a hand at rest, which throws nothing. The gradient is
that of the run, through release, flight, impact and rolling: their times move freely.

python examples/hand_throw.py [playback.html]
"""

import sys

import numpy as np
from hand_control.scene import hand
from hand_control.shooting import DT, Shooting, at_rest, solve, turn

import contactvi as cvi

SPAN = 0.8  # [s]
APEX = 0.35, 0.12  # [s], [m]: when the ball is to be how high above its start


def throw() -> cvi.Trajectory:
    """Find the motion of the hand, print what it does and return its run."""
    scene, start, held = hand((-0.045, -0.005))
    steps, top = round(SPAN / DT), round(APEX[0] / DT)

    def cost(t: np.ndarray, q: np.ndarray, v: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        J, slope_q, slope_v = at_rest(q, v, start)
        all_q, all_v = np.zeros_like(v), np.zeros_like(v)
        all_q[-1], all_v[-1] = slope_q, slope_v
        low = q[top, 21] - start[21] - APEX[1]
        all_q[top, 19:22] = 100.0 * low * turn(q[top])[2]
        return J + 50.0 * low**2, all_q, all_v

    problem = Shooting(scene, start, np.tile(held, (steps, 1)), cost)
    traj = problem.run(solve(problem), hold=200)
    released, caught = (c.time for c in traj.contact_changes if c.time > 0.01)
    rise = traj.q[:, 21] - start[21]
    miss, speed = np.linalg.norm(traj.q[steps, 19:22] - start[19:22]), np.linalg.norm(traj.v[steps, 19:22])
    print(f"released at {released:.3f} s, caught at {caught:.3f} s; {100 * rise.max():.1f} cm above the start at most")
    print(f"at {SPAN} s {1e3 * miss:.2f} mm beside its place in the palm, at {1e3 * speed:.2f} mm/s")
    assert caught - released > 0.25
    assert rise.max() > 0.12
    assert rise.max() > traj.q[:, 0].max() + 0.05  # it flies, and is not lifted with the palm
    assert miss < 2e-3
    assert speed < 5e-3
    assert np.linalg.norm(traj.q[-1, 19:22] - start[19:22]) < 5e-3  # and stays, for 0.4 s more
    return traj


def main() -> None:
    traj = throw()
    if len(sys.argv) > 1:
        traj.to_html(sys.argv[1], overwrite=True)


if __name__ == "__main__":
    main()
