"""Batches of a process that may have no more memory: runs that share lanes need stacks."""

from __future__ import annotations

import subprocess
import sys

import pytest

from helpers.commands import environment
from helpers.rollout_scenes import MODELS

# With AVX-512 eight runs share lanes, which need as many stacks of 8 MiB: there is room for some, one or none of them.
LITTLE_MEMORY = """
import resource
import numpy as np
import contactvi as cvi

scene = cvi.load_scene("{model}")
q0s = np.tile(scene.neutral(), (256, 1)) + 1e-3 * np.arange(256)[:, None]
settings = dict(dt=1e-3, duration=0.05, order=2, keep="ends")
before = cvi.simulate_batch(scene, q0s, workers=1, **settings)
used = int(next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmSize"))) << 10
resource.setrlimit(resource.RLIMIT_AS, (used + ({more} << 20), -1))
after = cvi.simulate_batch(scene, q0s, workers=1, **settings)
print(after.ok.all(), after.q.tobytes() == before.q.tobytes())
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="it limits the address space")
@pytest.mark.parametrize("more", [48, 24, 7])
@pytest.mark.slow
def test_runs_share_fewer_stacks_where_there_is_no_memory_for_more(more, tmp_path):
    code = LITTLE_MEMORY.format(model=MODELS / "double_pendulum_wall.toml", more=more)
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment(), capture_output=True, text=True, timeout=120
    )
    assert done.stdout.split() == ["True", "True"], done.stderr
