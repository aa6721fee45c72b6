"""Ctrl-C at random moments of runs, of loops, of imports and of commands, and what is left of them.

    python tests/helpers/interrupted_runs.py KIND COUNT SEED      # trials of a kind in a process of its own, as JSON

A trial returns what became of it, and its findings: sentences that say what is wrong. The signal comes from another
process, so that it hits any instruction. A run may end with INTERRUPTED and all nodes up to there, equal to the bit to
those of an undisturbed run; or raise KeyboardInterrupt where nothing was computed, or when the signal came before or
after the call. A loop around Simulator.step may be left by KeyboardInterrupt, and the simulator goes on or has ended.
"""

from __future__ import annotations

import functools
import json
import os
import random
import signal
import statistics
import subprocess
import sys
import time
import traceback
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

import contactvi as cvi
from helpers import commands, run_scenes

DT = 1e-3  # [s]
PATIENCE = 5.0  # [s] within which everything ends
STARTING = 0.03  # [s] of a call, in which a run may not have begun yet
SENDER = """
import os, signal, sys, time
for line in sys.stdin:
    delay, process = line.split()
    time.sleep(float(delay))
    os.kill(int(process), signal.SIGINT)
    print("sent", flush=True)
"""


@dataclass
class Trial:
    """One Ctrl-C.

    Attributes:
        kind: of run or command. share: of its time at which the signal was sent.
        outcome: what became of it. findings: what is wrong.
    """

    kind: str
    share: float
    outcome: str
    findings: list[str] = field(default_factory=list)


def shares(count: int, seed: int) -> list[float]:
    """Moments as shares of the time of a run: a third at the beginning, a third in the middle, a third near the end."""
    rng = random.Random(seed)
    thirds = ((0.0, 0.1), (0.1, 0.9), (0.9, 1.1))
    return [rng.uniform(*thirds[k % 3]) for k in range(count)]


# --- runs in a process ------------------------------------------------------------------------------------------------
def _falling_ball() -> cvi.Scene:
    return run_scenes.ball_scene(1.0)


def _plain(steps: int, **options: Any) -> cvi.Trajectory:
    return cvi.simulate(_falling_ball(), duration=steps * DT, dt=DT, throw=False, **options)


def _control(steps: int) -> cvi.Trajectory:
    return _plain(steps, control=lambda t, q, v: 1e-3 * np.sin(t) * np.ones(6))


def _own_force(steps: int) -> cvi.Trajectory:
    scene = _falling_ball()
    scene.add_force(lambda t, q, v: 1e-3 * np.sin(t) * np.ones(6), check=False)
    return cvi.simulate(scene, duration=steps * DT, dt=DT, throw=False)


_hand = functools.cache(run_scenes.hand_scene)


def _auto(steps: int) -> cvi.Trajectory:
    scene, q = _hand()
    return cvi.simulate(scene, q, duration=steps * DT, throw=False)


# kind: (call of a number of steps, that number)
RUNS: dict[str, tuple[Callable[[int], cvi.Trajectory], int]] = {
    "simulate": (_plain, 100_000),
    "simulate, progress bar": (lambda steps: _plain(steps, progress=True), 100_000),
    "simulate, ledger": (lambda steps: _plain(steps, ledger={"own_jump": 1e9}), 20_000),
    "simulate, control function": (_control, 5_000),
    "simulate, force in Python": (_own_force, 1_000),
    "simulate, dt auto": (_auto, 2_000),
}
LOOPS = {"Simulator.step": (1, 5_000), "Simulator.run": (20_000, 100_000)}  # steps per call, all steps


class Sender:
    """A process that sends Ctrl-C to this one."""

    def __init__(self) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", SENDER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        self.fired: list[float] = []
        self.place = ""  # where the last signal has struck
        signal.signal(signal.SIGINT, self._interrupted)

    def _interrupted(self, _: int, frame: Any) -> None:
        self.fired.append(time.perf_counter())
        self.place = _names(traceback.extract_stack(frame))
        raise KeyboardInterrupt

    def send(self, delay: float) -> None:
        assert self.process.stdin is not None
        self.fired.clear()
        self.process.stdin.write(f"{delay} {os.getpid()}\n")

    def wait(self) -> None:
        """Return when the signal was sent and has arrived; KeyboardInterrupt where it comes only now."""
        assert self.process.stdout is not None
        self.process.stdout.readline()
        deadline = time.monotonic() + 2.0
        while not self.fired and time.monotonic() < deadline:
            time.sleep(1e-3)
        if not self.fired:  # it came in the last lines of a call, where nothing is left to be ended
            self.fired.append(float("inf"))

    def close(self) -> None:
        self.process.kill()


def struck(sender: Sender, delay: float, call: Callable[[], Any]) -> tuple[Any, BaseException | None, float | None]:
    """Call, with Ctrl-C after a delay: the result, what the call raised, and the wall time [s]
    from the start of the call to the signal; None for a signal that came after the call."""
    result, error, ended, waited = None, None, None, False
    began = time.perf_counter()
    try:
        sender.send(delay)
        try:
            result = call()
        except (KeyboardInterrupt, Exception) as caught:
            error = caught
        ended = time.perf_counter()
        sender.wait()
        waited = True
    except KeyboardInterrupt:
        pass
    if not waited:  # the signal came after the call, or just at its end
        return result, None, None
    return result, error, sender.fired[0] - began if sender.fired[0] < ended else None


def of_runs(kind: str, count: int, seed: int) -> list[Trial]:
    """Interrupt calls of `simulate`."""
    call, steps = RUNS[kind]
    call(10)
    seconds, reference = _measured(lambda: call(steps))
    sender, trials = Sender(), []
    for share in shares(count, seed):
        traj, error, moment = struck(sender, share * seconds, lambda: call(steps))
        trial = Trial(kind, share, "")
        if error is not None and not isinstance(error, KeyboardInterrupt):
            trial.outcome = type(error).__name__
            trial.findings.append(f"{trial.outcome} in {_place(error)}: {str(error)[:200]}")
        elif error is not None:
            place = _place(error)
            trial.outcome = "KeyboardInterrupt"
            if place and moment is not None and moment > STARTING:
                trial.findings.append(
                    f"all is lost: KeyboardInterrupt after {moment:.2g} of {seconds:.2g} s in {place}"
                )
        elif traj is None:
            trial.outcome = "before or after the call"
        elif traj.status.code == cvi.StatusCode.INTERRUPTED:
            trial.outcome = "INTERRUPTED"
            trial.findings += partial(traj, reference, "auto" in kind)
            if moment is None:
                trial.findings.append("INTERRUPTED before the signal")
        else:
            trial.outcome = "after the run" if moment is None else "ended well"
            if traj.status.code != reference.status.code or len(traj.t) != len(reference.t):
                trial.findings.append(f"{traj.status} with {len(traj.t)} nodes")
            if moment is not None:
                trial.findings.append(f"Ctrl-C after {moment:.2g} of {seconds:.2g} s in {sender.place} did nothing")
        trials.append(trial)
    sender.close()
    return trials


def partial(traj: cvi.Trajectory, reference: cvi.Trajectory, auto: bool = False) -> list[str]:
    """What is wrong with an interrupted trajectory beside the whole one."""
    found = []
    if traj.t[-1] != traj.status.time:
        found.append(f"it has come to {traj.status.time:.6g} s, its last node is at {traj.t[-1]:.6g} s")
    if not auto:
        if np.diff(traj.t).max(initial=0.0) > 1.001 * DT:
            found.append(f"{len(traj.t)} nodes for {traj.status.time:.6g} s: a gap of {np.diff(traj.t).max():.6g} s")
        count = max(1, len(traj.t) - 1)  # the last one may lie inside of a step
        pairs = ((traj.t, reference.t), (traj.q, reference.q), (traj.p, reference.p))
        if not all(np.array_equal(own[:count], whole[:count]) for own, whole in pairs):
            found.append(f"its {len(traj.t)} nodes are not those of the whole run")
        impacts, early = traj.events.arrays["time"], reference.events.arrays["time"]
        early = early[early <= traj.t[count - 1]]
        if not np.array_equal(impacts[: len(early)], early):
            found.append(f"{len(impacts)} impacts instead of {len(early)}")
    if not np.isfinite(traj.q).all():
        found.append("numbers that are not finite")
    return found


def of_loops(kind: str, count: int, seed: int) -> list[Trial]:
    """Interrupt loops around a Simulator; afterwards it has recorded all that it did, and goes on or has ended."""
    each, steps = LOOPS[kind]
    seconds, reference = _measured(lambda: _loop(_simulator(), each, steps).trajectory())
    sender, trials = Sender(), []
    for share in shares(count, seed):
        sim = _simulator()
        struck(sender, share * seconds, lambda sim=sim: _loop(sim, each, steps))
        trial = Trial(kind, share, "goes on" if sim.status is not None and sim.status.ok else "has ended")
        trials.append(trial)
        try:
            trial.findings += behind(sim, reference)
            if sim.status is not None and sim.status.ok and sim.t < reference.t[-1] - 2 * DT:
                sim.run(1)
                trial.findings += [f"one step later: {text}" for text in behind(sim, reference)]
        except (cvi.ContactviError, ValueError) as error:
            trial.findings.append(f"{type(error).__name__}: {error}")
    sender.close()
    return trials


def behind(sim: cvi.Simulator, reference: cvi.Trajectory) -> list[str]:
    """What is wrong with what a simulator has recorded."""
    traj = sim.trajectory()
    late = [] if traj.t[-1] == sim.t else [f"it is at {sim.t:.6g} s, its last node at {traj.t[-1]:.6g} s"]
    return late + partial(traj, reference)


def _simulator() -> cvi.Simulator:
    sim = cvi.Simulator(_falling_ball(), dt=DT)
    sim.reset()
    return sim


def _loop(sim: cvi.Simulator, each: int, steps: int) -> cvi.Simulator:
    for _ in range(steps // each):
        status = sim.step() if each == 1 else sim.run(each)
        if not status.ok:
            break
    return sim


def _measured(call: Callable[[], Any]) -> tuple[float, Any]:
    times = []
    for _ in range(3):
        began = time.perf_counter()
        result = call()
        times.append(time.perf_counter() - began)
    return statistics.median(times), result


def _place(error: BaseException) -> str:
    """The innermost functions of contactvi in which an error was raised; empty where it was none of them."""
    return _names(traceback.extract_tb(error.__traceback__))


def _names(stack: traceback.StackSummary) -> str:
    frames = [frame for frame in stack if "contactvi/" in frame.filename]
    return " > ".join(f"{Path(frame.filename).name}:{frame.lineno} {frame.name}" for frame in frames[-3:])


# --- processes --------------------------------------------------------------------------------------------------------
IMPORT = (
    "import contactvi, sys; contactvi.Scene; contactvi.Simulator; contactvi.simulate; contactvi.plot; print('done')"
)
RUN_SECONDS = 2e4  # [s] simulated by `contactvi run`, a second or two of computing
COMMANDS: dict[str, tuple[list[str], tuple[int, ...]]] = {  # arguments, and codes with which they may end
    "contactvi run": (["run", "ball.toml", "-o", "out", "--record-every", "100", "--no-html"], (0, 3, 130)),
    "contactvi verify": (["verify", "bouncing-ball", "two-blocks", "tumbling-box", "stack"], (0, 130)),
    "contactvi check": (["check", run_scenes.HAND_URDF], (0, 130)),
}
KILLED = -signal.SIGINT  # before Python has a handler, and by programs that end like this on purpose


def of_commands(kind: str, count: int, seed: int, folder: Path) -> list[Trial]:
    """Interrupt commands."""
    arguments, codes = COMMANDS[kind]
    (folder / "ball.toml").write_text(run_scenes.BALL_TOML.format(restitution=1.0, duration=RUN_SECONDS))
    return [
        _of_process(kind, commands.program() + arguments, codes, share, seconds, folder)
        for seconds in [_seconds_of(commands.program() + arguments, folder)]
        for share in shares(count, seed)
    ]


def of_imports(count: int, seed: int, folder: Path) -> list[Trial]:
    """Interrupt `import contactvi` in a program of the user, where KeyboardInterrupt ends with Python's traceback."""
    program = [sys.executable, "-c", IMPORT]
    seconds = _seconds_of(program, folder)
    return [
        _of_process("import contactvi", program, (0, 1, 130), share, seconds, folder) for share in shares(count, seed)
    ]


def _seconds_of(program: list[str], folder: Path) -> float:
    began = time.monotonic()
    process = commands.start(program, folder)
    _, errors = process.communicate()
    assert process.returncode == 0, errors
    return time.monotonic() - began


def _of_process(
    kind: str, program: list[str], codes: tuple[int, ...], share: float, seconds: float, folder: Path
) -> Trial:
    output = folder / "out" / "trajectory.npz"
    output.unlink(missing_ok=True)
    process = commands.start(program, folder)
    time.sleep(share * seconds)
    process.send_signal(signal.SIGINT)
    sent = time.monotonic()
    patience = PATIENCE * max(1.0, seconds / 3.0)  # of machines with other work
    try:
        out, errors = process.communicate(timeout=4.0 * patience)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        return Trial(kind, share, "hangs", [f"it goes on for more than {4.0 * patience:.0f} s"])
    trial, code = Trial(kind, share, f"exit code {process.returncode}"), process.returncode
    if time.monotonic() - sent > patience:
        trial.findings.append(f"it went on for {time.monotonic() - sent:.1f} s")
    last = errors.strip().splitlines()[-1:]
    if code == 1 and last == ["KeyboardInterrupt"] and "entry.py" not in errors:
        return trial  # in Python's own start, before the program's first line
    if code not in (*codes, KILLED):
        failed = [" ".join(line.split()) for line in out.splitlines() if "FAILED" in line or "failed" in line]
        trial.findings.append(f"exit code {code}: {failed[:1] or last}")
    if kind == "import contactvi":
        if code == 1 and last != ["KeyboardInterrupt"]:
            trial.findings.append(f"it ends with {last}")
    elif "Traceback" in errors and "entry.py" in errors:  # before its first line the program has no say
        where = [line.strip() for line in errors.splitlines() if line.strip().startswith("File")]
        trial.findings.append(f"a traceback, exit code {code}: {where[-1] if where else ''} {last}")
    return _with_file(trial, code, output)


def _with_file(trial: Trial, code: int, output: Path) -> Trial:
    """Look at the file that a command has left."""
    if trial.kind != "contactvi run":
        return trial
    if not output.exists():
        if code in (0, 3):
            trial.findings.append(f"exit code {code} without a file")
        return trial
    try:
        traj = cvi.Trajectory.load(output)
    except cvi.ContactviError as error:
        trial.findings.append(f"the file cannot be read: {error}")
        return trial
    trial.outcome += f", file with {traj.status.code.name}"
    if traj.t[-1] != traj.status.time:
        trial.findings.append(f"the file ends at {traj.t[-1]:.6g} s, its status says {traj.status.time:.6g} s")
    nodes = int(traj.status.time / 1.0 + 1e-6) + 1  # one for every 100 steps of 1e-2 s, and the last state
    if not nodes <= len(traj.t) <= nodes + 1:
        trial.findings.append(f"{len(traj.t)} nodes for {traj.status.time:.6g} s")
    return trial


def in_process(kind: str, count: int, seed: int) -> list[Trial]:
    """The trials of a kind of runs or loops, made in a process of their own."""
    done = subprocess.run(
        [sys.executable, __file__, kind, str(count), str(seed)], env=commands.environment(), capture_output=True,
        text=True, timeout=1200,
    )  # fmt: skip
    if done.returncode != 0:
        return [Trial(kind, 0.0, "crash", [f"the process ended with {done.returncode}: {done.stderr.strip()[-500:]}"])]
    return [Trial(**fields) for fields in json.loads(done.stdout.splitlines()[-1])]


if __name__ == "__main__":
    kind, count, seed = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    warnings.simplefilter("ignore")
    made = of_loops(kind, count, seed) if kind in LOOPS else of_runs(kind, count, seed)
    print(json.dumps([asdict(trial) for trial in made]))
