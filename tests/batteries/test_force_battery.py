"""Battery of forces and closed systems: random scenes of batteries.force_scenes against every law of force_laws.

Contact of bodies and limits together with springs, dampers, joint friction, wrenches, functions of the user, servos,
prescribed motions and loops, also redundant ones; energy is balanced to O(h^2); runs repeat to the bit; violent scenes
keep the laws or end with a status. The long run, thousands of impacts: `pytest -m long -k thousands_of_impacts`.
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import contactvi as cvi
from batteries import contact_laws, force_laws, force_runner, force_scenes
from batteries.reporting import Altered, table
from batteries.runner import Report, Runner
from helpers.loop_scenes import arm_scene
from helpers.violent_scenes import VIOLENT, hinged_rod, ring, wedged_rod

SEEDS, LIMIT = 20, 60.0  # of each family in the normal run; [s] of wall time of one run
IMPACTS = 20_000  # of the long run
FAMILIES = tuple(force_scenes.FAMILIES)

# (family, seed, what goes wrong): left out of all other runs, and expected to fail in the long one, so that an entry
# that is mended has to go.
KNOWN: list[tuple[str, int, str]] = [
    ("closed_arm", 4, "two frictions of one axis in a loop: NEWTON_FAILED"),
    ("group", 54, "DTEC, e = 1, a force that damps: bounces without end, 80 ms a step"),
    ("joined", 198, "wedged between a point and a sticking point: forces of 1e6 N, NEWTON_FAILED"),
    ("kinds", 183, "DTEC jams with friction: IMPACT_UNSOLVED"),
]


def is_known(family: str, seed: int) -> bool:
    """Whether a run is in KNOWN."""
    return any((family, seed) == entry[:2] for entry in KNOWN)


@pytest.mark.parametrize("family", FAMILIES)
def test_random_scenes(family):
    reports = [force_runner.examine(family, seed) for seed in range(SEEDS) if not is_known(family, seed)]
    failed = [str(r) for r in reports if r.found]
    assert not failed, "\n".join(failed)
    assert sum(r.status == "SUCCESS" for r in reports) >= 0.7 * len(reports)
    assert sum(r.impacts for r in reports) > SEEDS


@pytest.mark.parametrize("friction", [0.0, 0.2])
@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.slow
def test_energy_is_balanced_to_the_second_order(family, friction):
    """Ratio of the errors of two steps: the median over scenes, as a single one may have another number of impacts."""
    ratios = []
    for seed in (seed for seed in range(8) if not is_known(family, seed)):
        errors = [force_runner.balance(family, seed, dt, friction=friction) for dt in (4e-3, 2e-3, 1e-3)]
        if None not in errors and errors[2] > 1e-11:  # rounding of momenta, summed
            ratios.append(math.sqrt(errors[0] / errors[2]))
    assert len(ratios) >= 4
    assert 3.5 < np.median(ratios) < 4.5


@pytest.mark.parametrize("family", FAMILIES)
def test_runs_repeat_to_the_bit(family):
    found = {seed: force_runner.made_again(family, seed) for seed in range(4) if not is_known(family, seed)}
    assert not any(found.values()), found


# --- laws by themselves -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("what", ["rest", "shaken", "one free"])
def test_joint_friction_sticks_to_the_bit(what):
    scene, q = arm_scene(3), np.array([0.3, -0.4, 0.5])
    scene.set_joint("j*", friction=100.0)
    if what == "shaken":
        scene.add_wrench("j3", lambda t: (30.0 * math.sin(20.0 * t), 0.0, 10.0))
    if what == "one free":
        scene.set_joint("j3", friction=0.0)
    traj = cvi.simulate(scene, q, duration=1.0, dt=1e-3)
    assert np.array_equal(traj.q[:, :2], np.tile(q[:2], (len(traj), 1)))


def test_a_ring_twice_closed_is_the_ring():
    """A second, equal loop changes nothing, up to rounding in the first contacts (the ring is chaotic)."""
    (scene, q), (twice, _) = ring(0.3, 0.0), ring(0.3, 0.0, twice=True)
    one, two = (cvi.simulate(s, q, duration=0.3, dt=1e-3) for s in (scene, twice))
    assert len(one.events) > 0
    assert two.q == pytest.approx(one.q, abs=1e-8)


@pytest.mark.parametrize("angle", [0.3, 0.4, 0.6])
def test_a_wedged_rod_rests_with_the_least_force(angle):
    """Along the line from pin to contact the force is not determined; the least one is less than the weight."""
    scene, q, v, options = wedged_rod(angle)
    traj = cvi.simulate(scene, q, v, **options)
    force = np.linalg.norm(traj.contacts.force[traj.contacts.h > 0.0], axis=1)
    assert len(force) > 200
    assert force.max() < 9.81
    assert np.abs(traj.reactions("pin")[150:]).max() < 9.81


@pytest.mark.parametrize("angle", [0.2, 0.4, 0.6])
def test_a_hinged_rod_rests_with_the_least_force(angle):
    scene, q, v, options = hinged_rod(angle)
    traj = cvi.simulate(scene, q, v, **options)
    force = np.linalg.norm(traj.contacts.force[traj.contacts.h > 0.0], axis=1)
    assert len(force) > 200
    assert force.max() < 9.81


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", VIOLENT)
def test_violent(name):
    """Energy is bounded, constraints and gaps are kept, and steps do not become slow."""
    scene, q, v, options = VIOLENT[name]()
    traj = cvi.simulate(scene, q, v, throw=False, **options)
    assert traj.status.ok, str(traj.status)
    assert np.isfinite(traj.p).all()
    found = [*force_laws.constraint_laws(traj), *force_laws.restitution_laws(traj)]
    found += contact_laws.gap_laws(traj)
    assert not found, [str(f) for f in found]
    if not np.any(traj.work.prescribed):
        assert traj.energy.max() <= traj.energy[0] + 1e-2 * force_laws.energy_scale(traj)
    assert force_runner.effort(traj.stats) < force_runner.SLOW


# --- the long run -----------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def runner() -> Iterator[Runner]:
    with Runner("batteries.force_runner") as one:
        yield one


@pytest.mark.long
def test_thousands_of_impacts(runner, capsys):
    reports: dict[str, list[Report]] = defaultdict(list)
    impacts = 0
    for seed in itertools.count(SEEDS):
        for family in FAMILIES:
            if not is_known(family, seed):
                reports[family].append(runner.examine(family, seed, LIMIT))
                impacts += reports[family][-1].impacts
        if impacts >= IMPACTS:
            break
    failed = [str(r) for r in itertools.chain(*reports.values()) if r.found]
    with capsys.disabled():
        print(f"\n{table(reports)}")
    assert not failed, f"{len(failed)} runs:\n" + "\n".join(failed)


@pytest.mark.long
@pytest.mark.parametrize(("family", "seed", "what"), KNOWN)
@pytest.mark.xfail(strict=True, reason="KNOWN: takes itself off the list when it is mended")
def test_known_failures(runner, family, seed, what):
    report = runner.examine(family, seed, LIMIT)
    assert not report.found, f"{what}: {report}"


# --- the battery itself -----------------------------------------------------------------------------------------------
def altered_forces(traj: cvi.Trajectory, **changes: Any) -> Altered:
    """A trajectory with other work."""
    return Altered(traj, work=traj.work._replace(**changes))


def test_the_laws_can_fail():
    drawn = force_scenes.draw("pushed", 8, impact="ctec", restitution=0.7, friction=0.0, dt=1e-3)
    traj = cvi.simulate(drawn.built.scene, drawn.q, drawn.v, **drawn.options)
    assert len(traj.events)
    assert not force_laws.broken(traj, drawn.built)
    rng = np.random.default_rng(0)
    late = (traj.t > 0.1)[:, None]
    wrong = {
        "constraint": Altered(traj, q=traj.q + late * 1e-9 * np.eye(traj.q.shape[1])[0]),
        "rate of a constraint": Altered(traj, v=traj.v + 1e-6),
        "damping gives": altered_forces(traj, damping=-traj.t),
        "input without any": altered_forces(traj, input=traj.t),
        "reaction of a prescribed motion": Altered(traj, p=traj.p + 1e-3 * rng.normal(size=traj.p.shape)),
    }
    for law, run in wrong.items():
        names = [found.law for found in force_laws.broken(run, drawn.built)]
        assert law in names, (law, names)
