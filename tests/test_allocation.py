"""A smooth step allocates nothing: malloc calls, counted by a preloaded shim, do not grow with the steps."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import textwrap

import pytest

SHIM = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stddef.h>
static void *(*real_malloc)(size_t);
static long calls;
void *malloc(size_t size) {
    if (!real_malloc) real_malloc = (void *(*)(size_t))dlsym(RTLD_NEXT, "malloc");
    __atomic_add_fetch(&calls, 1, __ATOMIC_RELAXED);
    return real_malloc(size);
}
long malloc_calls(void) { return calls; }
"""

# Built through the public face; then the engine alone, so that Python's own allocations stay out of the count.
PROGRAM = """
import ctypes
import numpy as np
import contactvi as cvi
from contactvi import _core

scene = cvi.Scene()
scene.add_urdf("example-robot-data://robots/allegro_hand_description/urdf/allegro_right_hand.urdf")
scene.add_sphere("ball", 0.03, 0.1, placement=(0.0, 0.0, 5.0))
scene.set_joint("joint_*", stiffness=0.5, damping=0.01, limits=False)
scene.core()
simulator = _core.Simulator(scene.core(), 1e-4)
simulator.reset(scene.neutral(), np.zeros(scene.nv))
count = ctypes.CDLL(None).malloc_calls
count.restype = ctypes.c_long

def calls(steps):
    before = count()
    out = simulator.advance(steps, record_every=10**9)
    after = count()
    assert out["code"] == 0 and out["events"] is None, out["message"]
    return after - before

calls(10)  # first use of the interpreter's own caches
print(calls(100), calls(2100))
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
        [sys.executable, "-c", textwrap.dedent(PROGRAM)],
        cwd=tmp_path,  # the source root would shadow the installed package
        env=dict(os.environ, LD_PRELOAD=str(shim), PYTHONPATH=os.pathsep.join(p for p in sys.path if p)),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    few, many = map(int, done.stdout.split())
    # Both calls allocate the same few arrays of their result; 2000 more steps must not add one each.
    assert few > 0
    assert many - few < 50
