"""Scenes that are made and dropped, again and again, take no memory."""

from __future__ import annotations

import gc
import os
import sys
from pathlib import Path

import pytest

import contactvi as cvi

SCENES = 1500
MOST = 40  # bytes each; a leaked GeometryModel has 110, a leaked archive 310
URDF = """<robot name="arm"><link name="base"/><link name="arm">
<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><sphere radius="1"/></geometry></visual>
<collision><geometry><box size="1 1 1"/></geometry></collision></link>
<joint name="hinge" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint></robot>"""


def resident() -> int:
    """Return the resident memory of this process [bytes]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.skipif(sys.platform != "linux", reason="the memory of a process is read from /proc")
@pytest.mark.slow
def test_scenes_with_a_urdf_leave_nothing_behind(tmp_path):
    (tmp_path / "arm.urdf").write_text(URDF)

    def make() -> None:
        scene = cvi.Scene()
        scene.add_urdf(tmp_path / "arm.urdf")
        scene.core()

    for _ in range(300):
        make()
    gc.collect()
    before = resident()
    for _ in range(SCENES):
        make()
    gc.collect()
    assert (resident() - before) / SCENES < MOST
