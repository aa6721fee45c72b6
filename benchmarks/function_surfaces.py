"""What a surface given by a function costs: Python against C, in one run and in batches of threads.

A ball bounces and rolls on z = .05 sin 3x cos 3y. Needs a C compiler, `cc`.

    python benchmarks/function_surfaces.py
"""

from __future__ import annotations

import argparse
import ctypes
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import contactvi as cvi

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from helpers.wavy_ground import bend, slope, waves

SOURCE = """
#include <math.h>
void height(double x, double y, double *f) {
  double a = sin(3 * x), b = cos(3 * x), c = sin(3 * y), d = cos(3 * y);
  f[0] = .05 * a * d; f[1] = .15 * b * d; f[2] = -.15 * a * c;
  f[3] = -.45 * a * d; f[4] = -.45 * b * c; f[5] = -.45 * a * d;
}
"""


class Compiled:
    """The C function, by its address."""

    def __init__(self, folder: Path) -> None:
        (folder / "height.c").write_text(SOURCE)
        subprocess.run(["cc", "-O2", "-shared", "-fPIC", "height.c", "-o", "height.so", "-lm"], cwd=folder, check=True)
        self._library = ctypes.CDLL(str(folder / "height.so"))
        self.address = ctypes.cast(self._library.height, ctypes.c_void_p).value


def scene_of(**surface: Any) -> cvi.Scene:
    scene = cvi.Scene()
    if surface:
        scene.add_surface("ground", **surface)
    else:
        scene.add_halfspace()
    scene.add_sphere("ball", 0.1)
    scene.set_contact(restitution=0.5, friction=0.5)
    return scene


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=64, help="of a batch")
    runs = parser.parse_args().runs
    with tempfile.TemporaryDirectory() as folder:
        kinds: dict[str, dict[str, Any]] = {
            "halfspace": {}, "C": {"height": Compiled(Path(folder))},
            "Python": {"height": waves, "gradient": slope, "hessian": bend},
            "Python, differences": {"height": waves},
        }  # fmt: skip
        starts = np.zeros((runs, 7))
        starts[:, 0], starts[:, 2], starts[:, 6] = np.linspace(-0.5, 0.5, runs), 0.4, 1.0
        print(f"{'ground':20} {'one run [ms]':>13} {'1 thread [ms/run]':>18} {'2 threads':>10}")
        for name, surface in kinds.items():
            scene = scene_of(**surface)
            cvi.simulate(scene, starts[0], duration=0.1, dt=0.005, order=4)
            spent = []
            for workers in (None, 1, 2):
                begin = time.perf_counter()
                if workers is None:
                    cvi.simulate(scene, starts[0], duration=1.0, dt=0.005, order=4)
                else:
                    cvi.simulate_batch(scene, starts, duration=1.0, dt=0.005, order=4, workers=workers)
                spent.append(1e3 * (time.perf_counter() - begin) / (1 if workers is None else runs))
            print(f"{name:20} {spent[0]:13.2f} {spent[1]:18.2f} {spent[2]:10.2f}")


if __name__ == "__main__":
    main()
