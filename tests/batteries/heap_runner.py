"""Runs of heaps in a process of their own, for test_heap_battery: as batteries.runner, with the laws of heap_laws."""

from __future__ import annotations

import time
from typing import Any

from batteries.runner import Report, main

DT = 1e-3
NODES = 2e5  # of all bodies together: where there are more, gaps are looked at every so many nodes


def examine(
    family: str, seed: int, duration: float | None = None, turning: tuple[float, float] = (0.0, 0.0), **chosen: Any
) -> Report:
    """Run one heap and check all laws; turning: radii of friction against spinning and rolling [m], which need
    friction; chosen: restitution, friction, count."""
    import contactvi as cvi
    from batteries import heap_laws
    from contactvi.bench import heaps

    heap = heaps.make(family, seed, **chosen)
    scene, q, v = heaps.to_scene(heap)
    if any(turning):
        scene.set_contact(spinning_radius=turning[0], rolling_radius=turning[1])
    start = time.perf_counter()
    traj = cvi.simulate(scene, q, v, duration or heap.duration, dt=DT, throw=False)
    every = max(1, int(len(traj.t) * len(heap.bodies) ** 2 / NODES))
    found = [str(f) for f in heap_laws.broken(heap, traj, DT, every)]
    if not traj.status.ok:
        found.insert(0, str(traj.status))
    shown = {**chosen, "turning": tuple(turning)} if any(turning) else chosen
    label = " ".join([family, str(seed), *(f"{name}={value}" for name, value in shown.items())])
    seconds, contact_steps = time.perf_counter() - start, traj.stats.contact_steps
    return Report(label, traj.status.code.name, found, traj.status.time, len(traj.events), contact_steps, seconds)


if __name__ == "__main__":
    main(examine)
