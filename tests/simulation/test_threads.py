"""Runs of one scene in several threads, and their derivatives: none disturbs another."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import contactvi as cvi
from derivatives.test_sensitivity import at_wall

OPTIONS = {"duration": 3.0, "dt": 0.01, "order": 4, "record": "gradient"}


def test_a_function_that_fails_ends_its_own_run_alone():
    """The other run is in the middle of a step of the same scene meanwhile."""
    scene, failed = cvi.Scene(), threading.Event()
    scene.add_sphere("ball", 0.1)

    def force(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        if q[0] > 1.0 and t > 0.01:
            failed.set()
            raise ValueError("too far")
        if t > 0.01:
            assert failed.wait(30.0)
        return -0.1 * v

    scene.add_force(force, lambda t, q, v: (np.zeros((6, 6)), -0.1 * np.eye(6)), check=False)
    near, far = scene.neutral(), scene.neutral()
    far[0] = 2.0
    with ThreadPoolExecutor(2) as pool:
        good = pool.submit(cvi.simulate, scene, near, duration=0.1, dt=1e-3)
        bad = pool.submit(cvi.simulate, scene, far, duration=0.1, dt=1e-3)
        with pytest.raises(cvi.UserFunctionError, match="too far"):
            bad.result()
        assert good.result().status.ok
    alone = cvi.simulate(scene, near, duration=0.1, dt=1e-3)
    assert (good.result().q == alone.q).all()


def test_derivatives_in_threads_have_the_same_bits():
    scene, q, v = at_wall(0.7)
    starts = [q + 0.01 * k for k in range(8)]

    def derivatives(start: np.ndarray) -> list[np.ndarray]:
        traj = cvi.simulate(scene, start, v, **OPTIONS)
        weights = (np.ones((len(traj.t), 2)), np.zeros((len(traj.t), 2)))
        first = cvi.gradient(traj, weights, ["q0", "v0", "control"])[1]
        second = cvi.hessian_vector(traj, weights, {"q0": v}, hessp=lambda t, q, v, dq, dv: (dq, dv))
        return [*first.values(), *second.product.values(), traj.sensitivity(["q0"]).matrix]

    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(derivatives, starts))
    for start, several in zip(starts, found, strict=True):
        assert all((a == b).all() for a, b in zip(several, derivatives(start), strict=True))
