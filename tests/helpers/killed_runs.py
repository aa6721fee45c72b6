"""Writers that are killed, and disks that are full: what is found under the name of the file afterwards.

    python tests/helpers/killed_runs.py save FOLDER        # writes FOLDER/trajectory.npz again and again
    python tests/helpers/killed_runs.py small FOLDER LIMIT # writes files while none may be larger than LIMIT bytes

A trial returns its findings, sentences that say what is wrong; an empty list is what a test wants.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import random
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import contactvi as cvi
from helpers import commands, run_scenes

DURATIONS = (4.0, 6.0)  # [s] of the old run and of the new one, which tell them apart
SIGNATURES = {".png": (b"\x89PNG", b"IEND\xaeB`\x82"), ".html": (b"<!", b"</html>")}


def scene_file(folder: Path, duration: float, restitution: float = 0.8) -> Path:
    path = folder / "ball.toml"
    path.write_text(run_scenes.BALL_TOML.format(restitution=restitution, duration=duration))
    return path


def run(folder: Path, duration: float) -> subprocess.Popen[str]:
    """Start `contactvi run` of a ball; the results go to folder/out."""
    arguments = ["run", str(scene_file(folder, duration)), "-o", "out", "--plot"]
    return commands.start(commands.program() + arguments, folder)


def problems(folder: Path, durations: tuple[float, ...]) -> list[str]:
    """What is wrong with the named files of a folder: each is missing, or one of complete runs of these durations."""
    found = []
    for path in sorted(folder.iterdir()):
        if path.suffix == ".npz" and not path.name.endswith(".part"):
            try:
                traj = cvi.Trajectory.load(path)
                if traj.options.duration not in durations or len(traj.t) != round(traj.options.duration / 1e-2) + 1:
                    found.append(f"{path.name} holds {len(traj.t)} nodes of {traj.options.duration} s")
            except cvi.ContactviError as error:
                found.append(f"{path.name} cannot be read: {error}")
        elif path.suffix in SIGNATURES:
            begin, end = SIGNATURES[path.suffix]
            data = path.read_bytes().strip()
            if not data.startswith(begin) or not data.endswith(end):
                found.append(f"{path.name} is not complete: {data[:10]!r} ... {data[-10:]!r}")
    return found


def parts(folder: Path) -> list[str]:
    """The names of files that writers have left half done."""
    return sorted(path.name for path in folder.iterdir() if path.name.endswith(".part"))


def kill_command(folder: Path, seed: int, whole: float) -> list[str]:
    """Kill `contactvi run` over the results of an older one: at any time, or when it has begun to write.

    Args:
        whole: wall time of an undisturbed run [s].
    """
    rng = random.Random(seed)
    process = run(folder, DURATIONS[1])
    out = folder / "out"
    if seed % 2:
        time.sleep(rng.uniform(0.0, 1.1 * whole))
    else:
        deadline = time.monotonic() + 3.0 * whole
        wanted = rng.choice(["trajectory.npz", "playback.html", "energy.png"])
        while not any(wanted in name for name in parts(out)) and time.monotonic() < deadline:
            if process.poll() is not None:
                break
        time.sleep(rng.choice([0.0, rng.uniform(0.0, 0.02)]))
    process.kill()
    process.communicate()
    return problems(out, DURATIONS)


def kill_save(folder: Path, seed: int) -> list[str]:
    """Kill a process that saves two runs by turns."""
    process = commands.start([sys.executable, __file__, "save", str(folder)], folder)
    assert process.stdout is not None
    process.stdout.readline()  # it has begun
    time.sleep(random.Random(seed).uniform(0.0, 0.2))
    process.kill()
    process.communicate()
    return problems(folder, DURATIONS)


def kept_after_full(folder: Path, limit: int) -> list[str]:
    """Write over old files where none may be larger than `limit` bytes (0: the disk itself is small)."""
    old = {name: f"old {name}".encode() for name in ("trajectory.npz", "playback.html", "energy.png")}
    for name, data in old.items():
        (folder / name).write_bytes(data)
    process = commands.start([sys.executable, __file__, "small", str(folder), str(limit)], Path.home())
    out, errors = process.communicate(timeout=120)
    if process.returncode != 0:
        return [f"the writer ended with {process.returncode}: {errors.strip()[-300:]}"]
    found = [f"{name}: {text}" for name, text in json.loads(out.splitlines()[-1]).items() if text]
    found += [f"{name} is no longer the old file" for name, data in old.items() if (folder / name).read_bytes() != data]
    return found + [f"{name} is left" for name in parts(folder)]


@contextlib.contextmanager
def small_disk(folder: Path) -> Iterator[bool]:
    """Mount a disk with about 30 kB to spare on a folder; False where that is not allowed."""
    mount, mounted = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder)], False
    if os.geteuid() == 0 and shutil.which("mount") is not None:
        mounted = subprocess.run(mount, capture_output=True).returncode == 0
    try:
        if mounted:
            (folder / "filler").write_bytes(bytes(30_000))
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", str(folder)], check=True)


def save_one(folder: Path) -> None:
    """Save the shorter run undisturbed."""
    _ball(DURATIONS[0]).save(folder / "trajectory.npz", overwrite=True)


def _ball(duration: float) -> cvi.Trajectory:
    return cvi.simulate(run_scenes.ball_scene(0.8), duration=duration, dt=1e-2)


def _save_forever(folder: Path) -> None:
    runs = [_ball(duration) for duration in DURATIONS]
    print("ready", flush=True)
    for traj in itertools.cycle(runs):
        traj.save(folder / "trajectory.npz", overwrite=True)


def _write_small(folder: Path, limit: int) -> None:
    """Print what each writer raised that is not as it should be."""
    from contactvi.trajectory.plots import plot, save_figure

    traj = cvi.simulate(run_scenes.ball_scene(0.8), duration=400.0, dt=1e-2)
    save_figure(plot(traj), folder.parent / "warm_up.png", overwrite=True)  # fonts are cached
    if limit:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    told = {}
    for name, write in (
        ("trajectory.npz", partial(traj.save, overwrite=True)),
        ("playback.html", partial(traj.to_html, overwrite=True)),
        ("energy.png", partial(save_figure, plot(traj), overwrite=True)),
    ):  # fmt: skip
        try:
            write(folder / name)
            told[name] = "was written, the disk is not full"
        except cvi.ContactviError as error:
            told[name] = "" if str(folder / name) in str(error) else f"the error does not name the file: {error}"
        except BaseException as error:
            told[name] = f"{type(error).__name__}: {error}"
    print(json.dumps(told))


if __name__ == "__main__":
    if sys.argv[1] == "save":
        _save_forever(Path(sys.argv[2]))
    else:
        _write_small(Path(sys.argv[2]), int(sys.argv[3]))
