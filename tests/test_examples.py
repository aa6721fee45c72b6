"""The examples and the README's code run as they stand, headless."""

from __future__ import annotations

import json
import math
import os
import pathlib
import re
import subprocess
import sys
import time

import pytest

from helpers.extras import extra, needs_mujoco
from oracles import friction_laws

ROOT = pathlib.Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
SLOW = ("cart_optimization", "hand_throw", "hand_roll", "hand_mppi", "puppet_optimization", "push_box")
# Pages whose code is run.
PAGES = [
    "README.md",
    *(str(page.relative_to(ROOT)) for page in sorted((ROOT / "docs" / "guide").glob("*.md"))),
    *(f"docs/{name}.md" for name in ("optimal_control", "extending")),
    *(f"docs/coming_from_{name}.md" for name in ("drake", "mujoco", "pinocchio", "trep")),
]
NEEDS = {"identify_torch": "torch"}  # examples and the packages that they need, which the test extra does not bring

pytestmark = pytest.mark.skipif(not EXAMPLES, reason="the tests were copied without the examples")


def run(arguments: list[str], folder: pathlib.Path) -> str:
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env=dict(os.environ, MPLBACKEND="agg", PYTHONPATH=os.pathsep.join(p for p in sys.path if p)),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize(
    "path", [pytest.param(p, id=p.stem, marks=[pytest.mark.slow] * (p.stem in SLOW)) for p in EXAMPLES]
)
def test_example_runs(path, tmp_path):
    if path.stem in NEEDS:
        extra(NEEDS[path.stem])
    assert run([str(path)], tmp_path).strip()
    assert len(path.read_text().splitlines()) <= 100


@pytest.mark.parametrize("name", NEEDS)
def test_an_example_names_the_package_it_needs(name, tmp_path):
    """Where it is missing, as here: a file of its name that cannot be imported stands before it."""
    (tmp_path / f"{NEEDS[name]}.py").write_text("raise ImportError('missing')")
    path = os.pathsep.join([str(tmp_path), *(p for p in sys.path if p)])
    done = subprocess.run(
        [sys.executable, str(ROOT / "examples" / f"{name}.py")], env=dict(os.environ, PYTHONPATH=path),
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.strip() == f'This example needs {NEEDS[name]}: pip install "contactvi[{NEEDS[name]}]"'


def marked_code() -> dict[str, str]:
    """The Python blocks of the pages that follow a line <!-- run: NAME -->, by that name."""
    pages = [(ROOT / page).read_text() for page in PAGES]
    found = [
        block for page in pages for block in re.findall(r"<!-- run: (\S+) -->\n```python\n(.*?)```", page, re.DOTALL)
    ]
    assert len(dict(found)) == len(found), "two blocks have one name"
    return dict(found)


def run_marked(name: str, folder: pathlib.Path, more: str = "") -> list[str]:
    """The lines that a marked block prints, run in `folder` beside the models."""
    (folder / f"{name}.py").write_text(marked_code()[name] + more)
    (folder / "models").symlink_to(ROOT / "models")
    return run([f"{name}.py"], folder).splitlines()


def test_every_python_block_is_run():
    """Those of the pages all carry a mark, and every mark has a test below."""
    pages = "".join((ROOT / page).read_text() for page in PAGES)
    assert pages.count("```python") == len(marked_code())
    tested = set(re.findall(r'run_marked\("([a-z-]+)"', pathlib.Path(__file__).read_text()))
    assert tested == set(marked_code())


def test_readme_code_runs(tmp_path):
    """The box touches down, stops, and its corners carry it."""
    printed = run_marked("readme", tmp_path)
    assert [line.split()[-1] for line in printed[:8]] == ["begin"] * 4 + ["stick"] * 4
    corners = [line for line in printed[8:] if line.startswith("('ground', 'box') stick")]
    assert len(corners) == 4
    assert all(abs(float(line.rstrip(" ]").split()[-1]) - 2.0 * 9.81 / 4.0) < 1e-6 for line in corners)
    assert (tmp_path / "run.html").stat().st_size > 0


def test_guide_code_of_the_live_view_runs(tmp_path, monkeypatch):
    """No browser is opened; simulated time keeps up with wall time and is not ahead of it."""
    monkeypatch.setenv("BROWSER", "true")  # a command that does nothing
    began = time.monotonic()
    printed = run_marked("live", tmp_path, "print(sim.t)\n")
    assert "http://127.0.0.1:" in printed[0]
    assert 2.0 <= float(printed[-1]) < 2.001
    assert time.monotonic() - began > 2.0


def test_guide_code_of_the_spinning_ball_runs(tmp_path):
    """Restitution changes the height alone, in the world's axes; forward and backward agree."""
    more = "print(*dp[:, S.columns['restitution']].ravel())\n"
    more += "print(abs(slope['v0'] - 2.0 * (traj.q[-1, :3] - target) @ dp[:, S.columns['v0']]).max())\n"
    *_, world, difference = run_marked("spinning-ball", tmp_path, more)
    x, y, z = map(float, world.split())
    assert max(abs(x), abs(y)) < 1e-12
    assert z > 1.0
    assert float(difference) < 1e-12


def test_guide_code_of_tables_runs(tmp_path):
    """The normal forces of the corners of the box that has come to rest are its weight."""
    more = 'print(contacts[contacts["t"] > 0.9].groupby("t")["normal_force"].sum())\n'
    printed = run_marked("tables", tmp_path, more)
    weights = [float(line.split()[1]) for line in printed if line[:1].isdigit()]
    assert weights
    assert max(abs(weight - 2.0 * 9.81) for weight in weights) < 1e-3
    assert (tmp_path / "tables" / "units.csv").stat().st_size > 0


def test_guide_code_holds_a_contact_force(tmp_path):
    (line,) = run_marked("hold-a-force", tmp_path)
    *pair, mode, force, speed = line.split()
    assert pair == ["('wrist_2_link_0',", "'table')"]
    assert mode == "stick"
    assert abs(float(force) - 20.0) < 1e-6  # the tolerance of the quadratic programme
    assert float(speed) < 1e-9


def test_guide_code_lifts_a_ball_on_a_driven_wrist(tmp_path):
    """Before the wrist moves, a finger without contact rests where its servos hold its weight; others hold the ball."""
    more = """
import pinocchio as pin
weight = pin.computeGeneralizedGravity(scene.model, scene.model.createData(), traj.q[600])
angles = [float(traj.q[600, scene.q_index(f"joint_{k}.0")][0]) for k in range(4)]
print(*[0.5 * (closed[k] - angles[k]) - weight[scene.v_index(f"joint_{k}.0")][0] for k in range(4)])
print(*sorted({contact.pair[0] for contact in traj.contacts.at(0.6)}))
print(*traj.contacts.on(ball)[1][-1])
"""
    heights, force, pairs, torques, first, on_ball = run_marked("driven-wrist", tmp_path, more)
    before, after = map(float, heights.split())
    assert abs(before - 0.041) < 1e-3
    assert abs(after - before - 0.1) < 1e-4  # what sticks does not creep
    up = float(force.strip("[]").split()[0])
    assert abs(up - 10.3) < 0.1
    assert max(abs(float(unbalanced)) for unbalanced in torques.split()) < 1e-3  # [N m]; kd times 0.1 rad/s
    assert first.split() == ["link_11.0_0", "link_7.0_0", "palm_link_0"]
    assert all(shape in pairs for shape in first.split())
    assert abs(float(on_ball.split()[2]) - 0.1 * 9.81) < 1e-3


def test_guide_code_of_starts_runs(tmp_path):
    """The ball comes out of the ground by the least, which is straight up; nothing overlaps afterwards."""
    more = "print(q0[scene.q_index(ball)][2], *(apart.q - q0)[scene.q_index(ball)][:3])\n"
    moved, gap, ball = run_marked("starts", tmp_path, more)
    assert "moved 'ball' by 5 mm" in moved
    assert float(gap) >= -1e-9  # what a run promises
    low, x, y, up = map(float, ball.split())
    assert low == 0.045
    assert max(abs(x), abs(y)) < 1e-9
    assert abs(up - 0.005) < 1e-9


def test_guide_code_of_a_control_loop_runs(tmp_path):
    """The servo comes to where its torque is gravity's: kp (target - angle) = m g l sin(angle).

    The bar has 2/3 kg m^2 about its hinge and 5.4 N m s of damping: it swings out as exp(-4.05 t), 1e-14 in 8 s.
    """
    more = """
import pinocchio as pin
for _ in range(8000):
    sim.step(target=[0.5])
import numpy as np
torque = 50.0 * (0.5 - np.arctan2(*encoder.read().q[::-1]))
print(torque - pin.computeGeneralizedGravity(scene.model, scene.model.createData(), sim.q)[0])
"""
    *_, start, unbalanced = run_marked("control-loop", tmp_path, more)
    assert float(start) == 0.0
    assert abs(float(unbalanced)) < 1e-10


def test_guide_code_of_a_batch_runs(tmp_path):
    printed = run_marked("batch", tmp_path)
    assert printed[0].startswith("<BatchResult: 200 runs, 194 ok")
    assert "overlap" in printed[1]


def test_guide_code_of_the_first_run_runs(tmp_path):
    printed = run_marked("first-use", tmp_path)
    assert "palm_link_0" in printed[-1]  # the ball hits the palm
    assert (tmp_path / "run.npz").stat().st_size > 0
    assert (tmp_path / "run.html").stat().st_size > 0


def test_guide_code_of_a_named_environment_runs(tmp_path):
    assert run_marked("own-environment-name", tmp_path) == ["ThreadedVectorEnv (4, 3)"]


def test_guide_code_of_environments_runs(tmp_path):
    run_marked("environments", tmp_path)
    assert (tmp_path / "episode.html").stat().st_size > 0


def test_guide_code_of_an_environment_of_ones_own_runs(tmp_path):
    """The servo reaches what is wanted, but for what gravity bends it, m g l / 2 / kp at most, and two digits."""
    reached, _, wanted, _ = run_marked("own-environment", tmp_path)[0].split()
    assert abs(float(reached) - float(wanted)) <= 2.0 * 9.81 * 0.5 / 50.0 + 0.01


def test_guide_code_of_the_ledger_runs(tmp_path):
    """It prints the three jumps that the guide gives."""
    energy, discrete, modified = (abs(float(x)) for x in run_marked("ledger", tmp_path)[0].split())
    assert min(energy, discrete) > 1e-4
    assert modified < 1e-12


def test_guide_code_of_linear_systems_runs(tmp_path):
    """Six joints: the shapes of A, B, d/d dt and a_q."""
    assert run_marked("linear", tmp_path)[0] == "(12, 12) (12, 6) (12,) (6, 6)"


def test_guide_code_of_gradients_runs(tmp_path):
    """One impact at a known time; adjoint and tangent agree; a box that falls flat is refused."""
    printed = run_marked("gradients", tmp_path)
    assert printed[0] == "(101, 4, 5) (101, 4, 1) (1, 5)"
    assert printed[2].startswith("t = 0.656671045 s  lower_0 | wall")
    backward, forward = ([float(x) for x in part.strip("[ ").split()] for part in printed[3].split("]")[:2])
    assert backward == pytest.approx(forward, rel=1e-7)
    assert printed[4].startswith("(100, 2)")
    assert printed[5].startswith("witness ('ground', 'box') 0.10096")


def test_guide_code_of_second_derivatives_runs(tmp_path):
    """Newton's method with conjugate gradients, through the impact."""
    iterations, slope, events = run_marked("second", tmp_path)[0].split()
    assert int(iterations) <= 8
    assert float(slope) <= 1e-8
    assert events == "1"


def test_guide_code_of_a_linkage_runs(tmp_path):
    """It prints the numbers that the guide gives; the works account for the energy, up to the balance."""
    printed = run_marked("linkage", tmp_path, "\nprint(traj.energy[-1] - traj.energy[0])")
    power, balance, opened, gained = ([float(x) for x in line.split()] for line in printed)
    least, most, put_in, damping = power
    assert (round(least, 2), round(most, 2)) == (-1.25, 1.56)
    assert damping > 0.1
    assert abs(put_in - damping - gained[0]) <= balance[0] < 1.3e-5
    assert opened[0] <= 1e-14


def test_guide_code_of_a_driven_length_runs(tmp_path):
    printed = run_marked("driven-rod", tmp_path, "\nprint(abs(traj.ledger.energy_balance).max())")
    assert float(printed[-1]) < 1e-4  # [J], O(dt^2)


def test_guide_code_of_persistent_contact_runs(tmp_path):
    """At the two times that it promises, and the corners slide at 0.3 s."""
    printed = run_marked("persistent-contact", tmp_path)
    assert [line.split()[-1] for line in printed[:8]] == ["begin"] * 4 + ["stick"] * 4
    assert [round(float(line.split()[0]), 3) for line in (printed[0], printed[4])] == [0.101, 0.510]
    assert sum(line.startswith("slip") for line in printed[8:]) == 4
    assert (tmp_path / "forces.png").stat().st_size > 0


def test_guide_code_of_a_heap_runs(tmp_path):
    """By dense steps alone, and within the bounds of its ledger, which would raise."""
    printed = run_marked("heap", tmp_path, "\nprint(len(steps) == traj.stats.dense_steps, set(traj.phases['kind']))")
    assert "residual of Coulomb's law" in printed[0]
    assert printed[-1] == "True {np.str_('dense')}" or printed[-1] == "True {'dense'}"


def test_guide_code_of_simultaneous_impacts_runs(tmp_path):
    printed = run_marked("simultaneous", tmp_path, "\nprint(found.unique, found.certificate.certified)")
    assert printed[-1] == "True True"


def test_code_of_crocoddyl_runs(tmp_path):
    """Through one impact, whose time is free."""
    solved, impact = run_marked("fddp", tmp_path)
    assert solved.startswith("True")
    assert impact.startswith("1 ")


def test_code_of_problems_runs(tmp_path):
    """SLSQP and IPOPT find the same least effort."""
    printed = run_marked("problem", tmp_path)
    first, second = (float(line.split()[0].strip("[]")) for line in (printed[0], printed[-1]))
    assert first == pytest.approx(second, rel=1e-6)
    assert "Solve_Succeeded" in printed[-1]


def test_code_of_rollouts_in_torch_runs(tmp_path):
    """Forces are found that bring the pendulum to a place after it has hit the wall."""
    extra("torch")
    first, last = map(float, run_marked("rollout-torch", tmp_path)[0].split(" -> "))
    assert last < 0.02 * first


def test_code_of_rollouts_in_jax_runs(tmp_path):
    extra("jax")
    assert run_marked("rollout-jax", tmp_path)[0] == "(3, 2) (3, 1)"


def test_code_of_an_executor_for_ray_runs(tmp_path):
    extra("ray")
    assert run_marked("ray-executor", tmp_path)[-1] == "True True"


@needs_mujoco
def test_code_of_the_page_on_mujoco_runs(tmp_path):
    """Both have one mass matrix; the arm hits the floor, stays on it, and does not sink in."""
    printed = run_marked("from-mujoco", tmp_path)
    assert float(printed[0]) < 1e-14
    assert "begin" in printed[1]
    assert float(printed[2]) > -1e-10


def test_code_of_the_page_on_pinocchio_runs(tmp_path):
    """Momentum to rounding, and energy to the accuracy that was asked for, of 5 J."""
    momentum, energy = run_marked("from-pinocchio", tmp_path)
    assert abs(float(momentum.strip("[]"))) < 1e-14
    assert float(energy) < 1e-7


def test_code_of_the_page_on_trep_runs(tmp_path):
    """Shapes of f, fdx, fdu and fdxdx of a cart with one force."""
    assert run_marked("trep", tmp_path) == ["(4,) (4, 4) (4, 1) (4, 4)"]


def test_extending_own_force_runs(tmp_path):
    """A ball that falls for 5 s is as fast as its drag allows: v = v_limit tanh(g t / v_limit)."""
    speed, limit = map(float, run_marked("own-force", tmp_path)[0].split())
    assert abs(speed - limit * math.tanh(9.81 * 5.0 / limit)) < 1e-6


def test_extending_own_law_runs(tmp_path):
    assert abs(float(run_marked("own-law", tmp_path)[0]) - 0.9 * math.exp(-0.1 * math.sqrt(2.0 * 9.81 * 0.95))) < 1e-10


def test_extending_own_compliance_runs(tmp_path):
    deepest, balance = map(float, run_marked("own-compliance", tmp_path)[0].split())
    # Without damping 1e5 d^2.5 / 2.5 = m g (h + d): the law loses some of it on the way.
    assert 0.7 < 1e5 * deepest**2.5 / 2.5 / (0.8 * 9.81 * (0.1 + deepest)) < 1.0
    assert balance < 1e-4


def test_extending_own_friction_bound_runs(tmp_path):
    left, expected = map(float, run_marked("own-friction-bound", tmp_path)[0].split())
    assert abs(left - expected) < 1e-5


def test_extending_own_restitution_of_state_runs(tmp_path):
    found, law = map(float, run_marked("own-restitution-of-state", tmp_path)[0].split())
    assert abs(found - law) < 1e-9


def test_extending_own_friction_of_state_runs(tmp_path):
    """A ball without spin slides down an incline by the friction of its weight: constant acceleration."""
    found, expected = map(float, run_marked("own-friction-of-state", tmp_path)[0].split())
    assert abs(found - expected) < 1e-10


def test_extending_own_friction_runs(tmp_path):
    """The block slips again after one period of its limit cycle (tests/oracles/friction_laws.py)."""
    block = friction_laws.Oscillator(2.0, 100.0, 2.0 * 9.81, 0.1, 0.6, friction_laws.stribeck(0.6, 0.3, 0.2))
    slips = sorted(set(json.loads(run_marked("own-friction", tmp_path)[0])))
    assert abs(slips[1] - slips[0] - block.cycle()["period"]) < 0.011  # of numbers with two decimals


def test_extending_own_guard_runs(tmp_path):
    """Ball and box bounce on the waves and lie on them in the end, and the page is written."""
    ok, events, closed = run_marked("own-guard", tmp_path)[0].split()
    assert (ok, closed) == ("True", "True")
    assert int(events) > 4
    assert (tmp_path / "waves.html").stat().st_size > 0


def test_extending_own_sensor_runs(tmp_path):
    read, known = map(float, run_marked("own-sensor", tmp_path)[0].split())
    assert abs(read - known) < 1e-12
