"""Loops that the compiler makes for wider vectors too (base/instruction_sets.hpp) have the digits of the plain ones."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

CORE = Path(__file__).resolve().parents[2] / "core"
PROGRAM = """
#include "base/small_linear.hpp"
extern "C" int solve(int n, const double* a, const double* weight, double* x, double* y) {
  contactvi::SmallLinear linear;
  linear.reserve(n);
  linear.resize(n);
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) linear.at(i, j) = a[i + j * n];
  const bool regular = linear.factor();
  if (regular) linear.substitute(x);
  linear.minimum_norm(weight, y);
  return regular;
}
"""


@pytest.mark.skipif(
    shutil.which("g++") is None or not CORE.exists(), reason="needs GCC, which makes both, and the source"
)
def test_small_systems_have_the_same_bits(tmp_path):
    source = tmp_path / "solve.cpp"
    source.write_text(PROGRAM)
    solvers = []
    for name, options in (("wide", []), ("plain", ["-U__gnu_linux__"])):
        library = tmp_path / f"{name}.so"
        flags = ["-std=c++17", "-O3", "-ffp-contract=off", "-shared", "-fPIC", f"-I{CORE}", *options]
        files = [str(source), str(CORE / "base" / "small_linear.cpp")]
        subprocess.run(["g++", *flags, "-o", str(library), *files], check=True)
        solvers.append(ctypes.CDLL(str(library)).solve)
    rng = np.random.default_rng(0)
    singular = 0
    for n in range(1, 49):
        A = rng.normal(size=(n, n))
        if n % 3 == 0:
            A[:, -n // 3 :] = A[:, : n // 3] @ rng.normal(size=(n // 3, n // 3))
        weight, c = rng.uniform(0.5, 2.0, n), rng.normal(size=n)
        found = []
        for solve in solvers:
            a, w, x, y = A.flatten("F"), weight.copy(), c.copy(), c.copy()
            pointers = [part.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for part in (a, w, x, y)]
            regular = solve(n, *pointers)
            singular += 1 - regular
            found.append(np.concatenate([x, y]))
        np.testing.assert_array_equal(*found)
    assert singular == 32
