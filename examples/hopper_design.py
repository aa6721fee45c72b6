"""A hopper jumps to a height with the least effort: the forces of its leg and the stiffness of the spring beside it.

Nobody says when the foot hits the ground and leaves it: IPOPT gets exact derivatives through both times, in the forces
and in the stiffness. The same search with the stiffness held tells what the choice of the spring is worth.

python examples/hopper_design.py [PICTURE.png]  # pip install "contactvi[casadi]"
"""

import sys
import time

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin

import contactvi as cvi
from contactvi.control import Constraint, Evaluation, Inputs, Problem, quadratic

DT, HOLD, DURATION = 4e-3, 25, 0.8  # [s]; each force is held over 25 steps
START, APEX, LEG = 0.55, 0.75, 0.4  # heights of the body at the start and at the end; length of the leg at rest [m]
BODY, FOOT = 2.0, 0.2  # [kg]
SHOWN, SPRING = slice(4, 100, 8), "stiffness:leg"  # nodes at which the leg's length is bounded


def hopper() -> cvi.Scene:
    """Return a body that moves along z, and a round foot below it on a leg with a spring and a motor."""
    model = pin.Model()
    body = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "body")
    leg = model.addJoint(body, pin.JointModelPZ(), pin.SE3(np.eye(3), np.array([0.0, 0.0, -LEG])), "leg")
    model.appendBodyToJoint(body, pin.Inertia.FromBox(BODY, 0.2, 0.2, 0.1), pin.SE3.Identity())
    model.appendBodyToJoint(leg, pin.Inertia.FromSphere(FOOT, 0.04), pin.SE3.Identity())
    shapes = pin.GeometryModel()
    shapes.addGeometryObject(pin.GeometryObject("foot", leg, pin.SE3.Identity(), pin.hppfcl.Sphere(0.04)))
    scene = cvi.Scene.from_pinocchio(model, shapes, name="hopper")
    scene.add_halfspace(name="ground")
    scene.set_contact(restitution=0.0)
    scene.set_joint("leg", stiffness=300.0, damping=3.0)
    return scene


def at_the_top(t: np.ndarray, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the height and the velocity of the body at the end, and their gradients there."""
    return np.array([q[-1, 0], v[-1, 0]]), np.array([[1.0, 0.0], [0.0, 0.0]]), np.array([[0.0, 0.0], [1.0, 0.0]])


def length(t: np.ndarray, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return by how much the leg is longer than its spring at rest, at some nodes: the foot shall not hit the body."""
    nodes = np.arange(len(t))[SHOWN]
    rows = np.zeros((len(nodes), len(t), 2))
    rows[np.arange(len(nodes)), nodes, 1] = 1.0
    return q[SHOWN, 1], rows, np.zeros_like(rows)


def jump(softest: float, stiffest: float) -> tuple[Evaluation, np.ndarray]:
    """Return the run of the least effort with a spring in these bounds, and its forces; say how they were found."""
    problem = Problem(
        hopper(), DURATION, DT, q0=[START, 0.0], inputs=Inputs(hopper(), "leg", hold=HOLD), parameters=[SPRING],
        input_cost=quadratic(HOLD * DT), bounds={"inputs": (-80.0, 80.0), SPRING: (softest, stiffest)},
        constraints=[Constraint(at_the_top, [APEX, 0.0], [APEX, 0.0], "top"), Constraint(length, -0.3, 0.3, "leg")],
    )  # fmt: skip
    start = time.perf_counter()
    found = problem.nlp().solve(ipopt_tol=1e-6, ipopt_max_iter=200, ipopt_print_level=0, ipopt_sb="yes")
    best, stats = found["evaluation"], found["stats"]
    changes = [f"{c.change} at {c.time:.6f} s" for c in best.trajectory.contact_changes]
    values = problem.unpack(best.z)
    print(f"{stats['return_status']}: {stats['iter_count']} iterations, {found['evaluations']} runs,"
          f" {time.perf_counter() - start:.2f} s; stiffness {values[SPRING][0]:.2f} N/m, effort {best.cost:.4f} N^2 s;"
          f" top {best.trajectory.q[-1, 0]:.9f} m; contact: {', '.join(changes)}")  # fmt: skip
    assert stats["success"]
    check(problem, best)
    return best, values["inputs"][:, 0]


def check(problem: Problem, best: Evaluation) -> None:
    """Compare changes of the cost and of the top along a direction of forces and stiffness with differences."""
    along = np.append(np.cos(np.arange(len(best.z) - 1)), 10.0)  # last: the stiffness [N/m]
    ends = [problem.evaluate(best.z + count * 1e-3 * along) for count in (-2, -1, 1, 2)]
    weights = np.array([1.0, -8.0, 8.0, -1.0]) / 12e-3
    near = weights @ [[end.cost, *end.constraints[:2]] for end in ends]
    exact = np.vstack([best.gradient, best.jacobian[:2]]) @ along
    print("change of effort, height and speed along forces and stiffness", exact, "off differences by", exact - near)
    assert np.abs(exact - near).max() <= 1e-7 * np.abs(exact).max()


held, chosen = jump(300.0, 300.0), jump(100.0, 1500.0)
print(f"the choice of the spring saves {100.0 * (1.0 - chosen[0].cost / held[0].cost):.1f} % of the effort")
assert chosen[0].cost < held[0].cost
if len(sys.argv) > 1:
    figure, (heights, forces) = plt.subplots(2, sharex=True, layout="constrained")
    for (run, force), name in ((held, "spring held"), (chosen, "spring chosen")):
        q, t = run.trajectory.q, run.trajectory.t
        (line,) = heights.plot(t, q[:, 0], label=f"body, {name}")
        heights.plot(t, q.sum(axis=1) - LEG - 0.04, "--", color=line.get_color(), label=f"foot, {name}")
        forces.step(HOLD * DT * np.arange(len(force) + 1), [*force, force[-1]], where="post", label=name)
    heights.set(ylabel="height above the ground [m]")
    forces.set(ylabel="force of the leg's motor [N]", xlabel="t [s]")
    heights.legend()
    figure.savefig(sys.argv[1])
