"""One measurement of contact_scale.py in a process of its own: reads a job (JSON) and writes lines of JSON.

A line is a dict of results that are known from then on; the last one has "done". `time` lines say how far contactvi
has come. CPU seconds of this process, one thread; the best of up to three runs where a run takes less than a second.
"""

from __future__ import annotations

import json
import resource
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import scale_scenes as scenes

import contactvi as cvi
from contactvi.bench.mujoco_peer import MujocoPeer

MEMORY = 6 << 30  # [bytes] of address space: a run that eats more is a row of the table
SHORT, REPEATS = 1.0, 3  # [s]
LOOKS = 16  # configurations at which gaps are looked at
AT_ONCE = 10  # MuJoCo steps of one call
CHUNK = 5  # MuJoCo steps between two looks at its energy
PEERS = Path(__file__).resolve().parents[1] / "peers"


def tell(**values: Any) -> None:
    """Write what is known."""
    plain = {key: value.item() if isinstance(value, np.generic) else value for key, value in values.items()}
    print(json.dumps(plain), flush=True)


def best_of(run: Callable[[], float]) -> float:
    """Return the shortest of some runs [s]; a long one is made once."""
    times = [run()]
    while sum(times) < SHORT and len(times) < REPEATS:
        times.append(run())
    return min(times)


def looks(states: np.ndarray) -> np.ndarray:
    return states[np.unique(np.linspace(0, len(states) - 1, LOOKS).astype(int))]


# --- contactvi --------------------------------------------------------------------------------------------------------
def contactvi(job: dict[str, Any]) -> None:
    setup = scenes.make(**job["scene"])
    setup.scene.core()
    tell(ready=True, notes=setup.notes)
    {"run": run_contactvi, "idle": idle_contactvi, "rest": rest_contactvi, "reset": reset_contactvi}[job["measure"]](
        job, setup
    )


def follow() -> Callable[[float, int], None]:
    """A progress callback that tells the time reached twice a second."""
    last = [time.monotonic()]

    def progress(t: float, _: int) -> None:
        if time.monotonic() - last[0] > 0.5:
            last[0] = time.monotonic()
            tell(time=t)

    return progress


def started(job: dict[str, Any], setup: scenes.Setup) -> cvi.Simulator | None:
    """A simulator at the start; None where the start is refused."""
    options = {"record_every": job.get("record_every", 1), **job.get("options", {})}
    simulator = cvi.Simulator(setup.scene, dt=job["dt"], **options)
    try:
        simulator.reset(setup.q0, setup.v0)
    except cvi.ContactviError as error:
        tell(status=type(error).__name__, message=str(error)[:160])
        return None
    return simulator


def run_contactvi(job: dict[str, Any], setup: scenes.Setup) -> None:
    steps = round(job["duration"] / job["dt"])
    simulator = started(job, setup)
    if simulator is None:
        return

    def run() -> float:
        simulator.reset(setup.q0, setup.v0)
        began = time.process_time()
        simulator.run(steps, progress=follow())
        return time.process_time() - began

    seconds = best_of(run)
    status = simulator.status
    assert status is not None
    reached = max(simulator.t, job["dt"])
    tell(seconds=seconds, time=simulator.t, status=status.code.name, message=status.message[:160], steps=steps)
    tell(ms_per_s=1e3 * seconds / reached, us_per_step=1e6 * seconds * job["dt"] / reached)
    impacts = simulator.impacts
    if impacts:
        tell(us_per_impact=1e6 * seconds / impacts)
    judge_contactvi(simulator.trajectory(), setup)


def judge_contactvi(traj: cvi.Trajectory, setup: scenes.Setup) -> None:
    """Accuracy: gaps by coal, energy, and how far impulses are from Coulomb's law."""
    stats, rows, ledger = traj.stats, traj.contacts, traj.ledger
    tell(counts=stats.to_dict())
    kinetic = energy_scale(setup.scene, float(traj.kinetic_energy.max()))
    if setup.free:
        energy = traj.energy
        tell(rise=(energy - np.minimum.accumulate(energy)).max() / kinetic, drift=np.ptp(energy) / kinetic)
    tell(balance=np.abs(ledger.energy_balance).max() / kinetic)
    if len(rows):
        tell(gap_rows=min(0.0, rows.array("gap").min()), residual=residual(traj))
    if setup.gap is not None:
        tell(gap=min(setup.gap(q) for q in looks(traj.q)))


def energy_scale(scene: cvi.Scene, kinetic: float) -> float:
    """What energy errors are compared with [J]: the largest kinetic energy, at least the weight times 1 mm."""
    mass = sum(float(inertia.mass) for inertia in scene.model.inertias)
    return max(kinetic, 1e-3 * mass * float(np.linalg.norm(scene.gravity)))


def residual(traj: cvi.Trajectory) -> float:
    """How far the worst impulse lies outside of its cone, relative to the largest impulse of the run.

    Of steps the velocity impulses: the normal at the start of a step, to which the position impulse belongs, is not
    recorded in its row.
    """
    rows = traj.contacts
    pairs = rows.array("kind") == 0
    if not pairs.any():
        return 0.0
    normal, mu = rows.array("normal")[pairs], traj.scene.pair_friction[rows.array("index")[pairs]]
    impulse = np.where(rows.h[:, None] > 0.0, rows.array("end"), rows.impulse)[pairs]
    along = np.einsum("ij,ij->i", impulse, normal)
    across = np.linalg.norm(impulse - along[:, None] * normal, axis=1)
    size = max(float(np.linalg.norm(impulse, axis=1).max()), 1e-300)
    return float(np.maximum(across - mu * np.maximum(along, 0.0), -along).max(initial=0.0)) / size


def idle_contactvi(job: dict[str, Any], setup: scenes.Setup) -> None:
    """The share of the time that the idle bodies take, beside that of the hand alone."""
    alone = scenes.make("idle", count=0)
    steps = round(job["duration"] / job["dt"])
    seconds = []
    for one in (alone, setup):
        simulator = started(job, one)
        if simulator is None:
            return

        def run(simulator: cvi.Simulator = simulator, one: scenes.Setup = one) -> float:
            simulator.reset(one.q0, one.v0)
            # What is at rest from the start is found so after 32 steps.
            simulator.run(40, progress=follow())
            began = time.process_time()
            simulator.run(steps, progress=follow())
            return time.process_time() - began

        seconds.append(best_of(run))
        tell(hand_us_per_step=1e6 * seconds[0] / steps)
    tell(seconds=seconds[1], share=seconds[1] / seconds[0] - 1.0, us_per_step=1e6 * seconds[1] / steps)
    tell(time=simulator.t, status=simulator.status.code.name)


def rest_contactvi(job: dict[str, Any], setup: scenes.Setup) -> None:
    """Steps of bodies at rest, after some to settle; awake: forces of 1e-9 N change from step to step."""
    steps = round(job["duration"] / job["dt"])
    tau = None
    if job["awake"]:
        tau = 1e-9 * (-1.0) ** np.arange(steps)[:, None] * np.ones(setup.scene.nv)
    simulator = started(job, setup)
    if simulator is None:
        return

    def run() -> float:
        simulator.reset(setup.q0, setup.v0)
        simulator.run(200, tau=None if tau is None else tau[:200], progress=follow())
        began = time.process_time()
        simulator.run(steps, tau=tau, progress=follow())
        return time.process_time() - began

    seconds = best_of(run)
    tell(seconds=seconds, us_per_step=1e6 * seconds / steps, time=simulator.t, status=simulator.status.code.name)
    judge_contactvi(simulator.trajectory(), setup)


def reset_contactvi(job: dict[str, Any], setup: scenes.Setup) -> None:
    """The first reset of a simulator, and the fastest of some further ones."""
    simulator = cvi.Simulator(setup.scene, dt=job["dt"])
    times = []
    for _ in range(4):
        began = time.process_time()
        simulator.reset(setup.q0, setup.v0)
        times.append(1e3 * (time.process_time() - began))
        tell(ms_first=times[0], ms=min(times[1:], default=times[0]), pairs=len(setup.scene.pair_names))
    tell(status="SUCCESS", seconds=1e-3 * min(times[1:]))


# --- MuJoCo -----------------------------------------------------------------------------------------------------------
def mujoco(job: dict[str, Any]) -> None:
    setup = scenes.make(**job["scene"])
    peer = MujocoPeer(setup.scene, job["dt"])
    tell(ready=True)
    {"run": run_mujoco, "idle": idle_mujoco, "rest": rest_mujoco, "reset": reset_mujoco}[job["measure"]](
        job, setup, peer
    )


def run_mujoco(job: dict[str, Any], setup: scenes.Setup, peer: MujocoPeer) -> None:
    steps, package = round(job["duration"] / job["dt"]), peer.mujoco

    def run() -> float:
        data, told = peer.data(setup.q0, setup.v0), time.monotonic()
        began = time.process_time()
        for done in range(0, steps, AT_ONCE):
            package.mj_step(peer.model, data, min(AT_ONCE, steps - done))
            if time.monotonic() - told > 1.0:
                told = time.monotonic()
                tell(time=float(data.time), so_far=1e3 * (time.process_time() - began) / float(data.time))
        return time.process_time() - began

    seconds = best_of(run)
    tell(seconds=seconds, ms_per_s=1e3 * seconds / job["duration"], us_per_step=1e6 * seconds / steps)
    judge_mujoco(steps, setup, peer)


def judge_mujoco(steps: int, setup: scenes.Setup, peer: MujocoPeer) -> None:
    """The run again, with looks at gaps, energy and the solver in between."""
    package, model, data = peer.mujoco, peer.model, peer.data(setup.q0, setup.v0)
    energy, kinetic, states, gradient, contacts = [], [], [], 0.0, 0
    for done in range(0, steps, CHUNK):
        package.mj_step(model, data, min(CHUNK, steps - done))
        package.mj_energyPos(model, data)
        package.mj_energyVel(model, data)
        energy.append(float(data.energy.sum()))
        kinetic.append(float(data.energy[1]))
        states.append(data.qpos.copy())
        contacts = max(contacts, int(data.ncon))
        gradient = max(gradient, last_gradient(data))
    steady = np.isfinite(states).all() and not sum(warning.number for warning in data.warning)
    tell(status="SUCCESS" if steady else "UNSTABLE", contacts=contacts, gradient=gradient)
    top = energy_scale(setup.scene, max(kinetic))
    if setup.free:
        tell(rise=(np.array(energy) - np.minimum.accumulate(energy)).max() / top, drift=np.ptp(energy) / top)
    if setup.gap is not None and steady:
        tell(gap=min(setup.gap(peer.configuration(q)) for q in looks(np.array(states))))


def last_gradient(data: Any) -> float:
    """The scaled gradient at which the solver stopped, of the first island that has contacts."""
    count = int(data.solver_niter[0])
    return float(data.solver.gradient[count - 1]) if count else 0.0


def timed_mujoco(peer: MujocoPeer, setup: scenes.Setup, steps: int, settle: int) -> float:
    def run() -> float:
        data = peer.data(setup.q0, setup.v0)
        peer.mujoco.mj_step(peer.model, data, settle)
        began = time.process_time()
        peer.mujoco.mj_step(peer.model, data, steps)
        return time.process_time() - began

    return best_of(run)


def idle_mujoco(job: dict[str, Any], setup: scenes.Setup, peer: MujocoPeer) -> None:
    alone = scenes.make("idle", count=0)
    steps = round(job["duration"] / job["dt"])
    seconds = []
    for one, other in ((alone, MujocoPeer(alone.scene, job["dt"])), (setup, peer)):
        other.model.opt.enableflags |= int(peer.mujoco.mjtEnableBit.mjENBL_SLEEP)
        seconds.append(timed_mujoco(other, one, steps, 500))
    tell(seconds=seconds[1], share=seconds[1] / seconds[0] - 1.0, us_per_step=1e6 * seconds[1] / steps)
    tell(status="SUCCESS", hand_us_per_step=1e6 * seconds[0] / steps)


def rest_mujoco(job: dict[str, Any], setup: scenes.Setup, peer: MujocoPeer) -> None:
    steps = round(job["duration"] / job["dt"])
    if not job["awake"]:
        peer.model.opt.enableflags |= int(peer.mujoco.mjtEnableBit.mjENBL_SLEEP)
    seconds = timed_mujoco(peer, setup, steps, 500)
    tell(seconds=seconds, us_per_step=1e6 * seconds / steps)
    judge_mujoco(steps, setup, peer)


def reset_mujoco(job: dict[str, Any], setup: scenes.Setup, peer: MujocoPeer) -> None:
    data = peer.data(setup.q0, setup.v0)
    q, times = data.qpos.copy(), []
    for _ in range(10):
        began = time.process_time()
        peer.mujoco.mj_resetData(peer.model, data)
        data.qpos[:] = q
        peer.mujoco.mj_forward(peer.model, data)
        times.append(1e3 * (time.process_time() - began))
    tell(status="SUCCESS", ms=min(times), seconds=1e-3 * min(times))


# --- S7, as in compare_hand.py ----------------------------------------------------------------------------------------
def hand(job: dict[str, Any], engine: str) -> None:
    sys.path.insert(0, str(PEERS))
    import hand as s7
    import hand_contactvi
    import hand_mujoco
    from hand_measures import Measures

    setting = {
        "contactvi": {"order": 2, "dt": job["dt"]},
        "mujoco": {"integrator": "implicitfast", "dt": job["dt"], "cone": "elliptic", "stiff": True},
    }[engine]
    module = {"contactvi": hand_contactvi, "mujoco": hand_mujoco}[engine]
    with tempfile.TemporaryDirectory() as folder:
        plain = s7.job(Path(folder))
        prepared = module.prepare(plain, setting)
        tell(ready=True)

        def run() -> float:
            began = time.process_time()
            prepared()
            return time.process_time() - began

        prepared()
        seconds = best_of(run)
        tell(seconds=seconds, ms_per_s=1e3 * seconds / plain["duration"], status="SUCCESS")
        fine = {**plain, "sample": 1e-3}
        q, v, *_ = module.prepare(fine, setting)()
        seen = Measures({**fine, "start": plain["start"]}, s7.model(), np.asarray(q), np.asarray(v))
        tell(gap=-seen.overlap, held=bool(seen.held))


def main() -> None:
    warnings.simplefilter("ignore")
    engine, job = sys.argv[1], json.loads(sys.stdin.read())
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    try:
        if job["measure"] == "hand":
            hand(job, engine)
        else:
            {"contactvi": contactvi, "mujoco": mujoco}[engine](job)
    except Exception as error:
        tell(status=type(error).__name__, message="".join(traceback.format_exception_only(error)).strip()[:200])
        print(traceback.format_exc(), file=sys.stderr)
    tell(done=True)


if __name__ == "__main__":
    main()
