"""The woodpecker toy with Newton's restitution (contactvi.verify.woodpecker), against its oracle."""

from __future__ import annotations

import numpy as np
import pytest

import contactvi as cvi
from contactvi.verify import woodpecker
from oracles import woodpecker as toy


@pytest.mark.thinned(2)
@pytest.mark.parametrize("options", [{"dt": 2.5e-4, "order": 8}, {"dt": "auto", "tol": 1e-8}])
def test_a_period_of_the_limit_cycle(tmp_path, options) -> None:
    """From a state on the cycle: the first impact, the period and the state after it are the oracle's."""
    period, drop, _, motion = toy.limit_cycle()
    _, q0, u0, _ = motion.log[0]
    scene = woodpecker.woodpecker(tmp_path)
    q, v = woodpecker.start(scene, q0, u0)
    run = cvi.simulate(scene, q, v, duration=0.15, **options)
    assert run.status.ok
    q = run.at(period).q
    found = np.hstack([q[scene.q_index(name)] for name in ("y", "s_M", "s_S")]) / [1.0, toy.LM, toy.LG]
    # Runs with steps of twice this length differ from it by 5e-12.
    np.testing.assert_allclose(found, q0 - [drop, 0.0, 0.0], rtol=0.0, atol=1e-10)
    first = next(t for t, _, _, text in motion.log if text.startswith("impact"))
    assert abs(run.events[0].time - first) < 1e-11
    slips = [change.time for change in run.contact_changes if change.change == "slip"]
    assert (
        abs(slips[-1] - period) < 2e-9
    )  # a slip begins where friction is as large as it may be, to rounding of forces
