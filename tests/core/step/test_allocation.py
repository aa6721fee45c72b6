"""A smooth step allocates nothing: malloc calls, counted by a preloaded shim, do not grow with the steps."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import textwrap

import pytest

from helpers.malloc_shim import SHIM

# Scenes are built through the Python API. Then the engine runs alone, so that Python's allocations are not counted.
PROGRAM = """
import ctypes
import sys
import numpy as np
import pinocchio as pin
import contactvi as cvi
from helpers import engine
from helpers.engine import core_scene

count = ctypes.CDLL(None).malloc_calls
count.restype = ctypes.c_long

hand = cvi.Scene()
hand.add_urdf("example-robot-data://robots/allegro_hand_description/urdf/allegro_right_hand.urdf")
hand.add_sphere("ball", 0.03, 0.1, placement=(0.0, 0.0, 5.0))
hand.set_joint("joint_*", stiffness=0.5, damping=0.01, limits=False)
near = cvi.Scene(gravity=(0.0, 0.0, 0.0))  # moves 0.01 mm over the ground: evaluated in every step
near.add_capsule("stick", 0.1, 0.5, mass=1.0, placement=((0.0, 0.0, 0.10001), (0.0, np.pi / 2, 0.0)))
near.add_halfspace()
passing = np.array([0.0, 0.0, 0.3, 0.0, 0.0, 0.0])
SCENES = {
    "contact-free": (core_scene(hand.model), hand.neutral(), np.zeros(hand.nv)),
    "guards far away": (hand.core(), hand.neutral(), np.zeros(hand.nv)),
    "guard nearby": (near.core(), near.neutral(), passing),
}

def calls(run):
    before = count()
    out = run()
    after = count()
    assert out["code"] == 0 and out["events"] is None, out["message"]
    return after - before, out["stats"]

def fixed(steps):
    return lambda: simulator.advance(steps, record_every=10**9)

def auto(duration):
    return lambda: simulator.run_auto(duration, level)[0].results()

for name, (core, q, v) in SCENES.items():
    for order in map(int, sys.argv[1:]):
        simulator = engine.simulator(core, 1e-4, order=order)
        simulator.reset(q, v)
        calls(fixed(10))  # first use of the interpreter's own caches
        few, many = calls(fixed(100))[0], calls(fixed(1100))[0]
        assert few > 0
        # Both calls allocate the same few arrays of their result; 1000 more steps must not add one each.
        assert many - few < 50, (name, order, few, many)
        print(name, order)

alone = cvi.Scene()  # no free body: momenta of those are converted node by node
alone.add_urdf("example-robot-data://robots/allegro_hand_description/urdf/allegro_right_hand.urdf")
alone.add_halfspace(offset=-1.0)
alone.set_joint("joint_*", stiffness=0.5, limits=False)
for order, level in ((4, 1e-7), (8, 1e-12), (16, 1e-14)):
    simulator = engine.simulator(alone.core(), 1e-4, order=order)
    simulator.reset(alone.neutral(), np.zeros(alone.nv))
    (few, before), (many, after) = calls(auto(1e-4)), calls(auto(0.2))
    steps = after["steps"] - before["steps"]
    assert steps > 150
    # Nodes are in vectors that double; a state to go back to is kept at each doubling of the steps and each try at one.
    assert many - few < 60 + 20 * (after["rejected"] + np.log2(steps)), (order, few, many, steps)
    print("auto", order)
"""


@pytest.mark.skipif(shutil.which("gcc") is None or not sys.platform.startswith("linux"), reason="needs gcc on Linux")
def test_a_smooth_step_allocates_nothing(tmp_path):
    (tmp_path / "shim.c").write_text(SHIM)
    shim = tmp_path / "shim.so"
    subprocess.run(
        ["gcc", "-O1", "-shared", "-fPIC", str(tmp_path / "shim.c"), "-o", str(shim), "-ldl"],
        check=True,
        cwd=tmp_path,
        timeout=60,
    )
    # The child finds contactvi the way this interpreter does, installed or in place.
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(PROGRAM), "2", "4", "8", "16"],
        cwd=tmp_path,  # the source root would shadow the installed package
        env=dict(os.environ, LD_PRELOAD=str(shim), PYTHONPATH=os.pathsep.join(p for p in sys.path if p)),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == 15
