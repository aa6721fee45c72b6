"""Seconds of loading robot models beside MuJoCo's compiler, and of `contactvi run` by part.

    python benchmarks/loading.py [--repeats 3] [--only h1|mjcf|urdf|run] [--match TEXT] [--all] [-o DIR]

Needs mujoco, gymnasium, dm_control and example-robot-data (`pip install "contactvi[test]"`), and runs from the source
tree: the lists of files are those of the tests. All numbers are wall times, the least of the repeats.

- h1: a robot of 33 degrees of freedom with 40 visual meshes of 20 000 to 60 000 triangles (STL and OBJ), which this
  script writes (into DIR where one is given).
- mjcf: every XML of gymnasium and dm_control. urdf: every URDF of example-robot-data. `--all` prints each file.
- A load is the scene with its file, and the engine's scene of it: cold with an empty cache of contactvi, warm with what
  that has left there. Modules are imported, and files are in the cache of the operating system.
- MuJoCo's time is that of mujoco.MjModel.from_xml_path, without the cache that it has in the process. It is given a
  URDF with the absolute paths of its meshes; it has no reader of DAE, and does without the pictures of a URDF.
- save: what is written after a run of 20 steps, its pictures included; cold and warm as above.
- run: `contactvi run` of three robots with hands, seconds by part; the process with its imports is "all".
"""

from __future__ import annotations

import argparse
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import contactvi as cvi

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from helpers import mjcf_files, robot_files

MESHES, DOFS, CHAINS = 40, 27, 5  # of the robot that is written, without those of its free base
LEAST, MOST = 20_000, 60_000  # triangles of a mesh
SLOW = 0.05  # [s] from which on a file counts as one that takes MuJoCo long
DATA = "example-robot-data://robots/"
HANDS = {
    "Allegro hand": DATA + "allegro_hand_description/urdf/allegro_right_hand.urdf",
    "Panda with its hand": DATA + "panda_description/urdf/panda.urdf",
    "g1 with two hands": DATA + "g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf",
}
PARTS = ("imports", "build", "run", "save", "playback", "plots")
RUN = "from contactvi.commands.entry import main; main()"


class Model(NamedTuple):
    """A file, and the arguments with which a scene takes it."""

    label: str
    path: Path
    options: dict[str, Any]


class Row(NamedTuple):
    """Seconds of one file; MuJoCo's are nan where it cannot read it, for the reason given."""

    label: str
    mujoco: float
    cold: float
    warm: float
    save_cold: float
    save_warm: float
    reason: str


# --- the robot with large meshes --------------------------------------------------------------------------------------
def bumpy_surface(triangles: int, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (n, 3) [m] and triangles (m, 3) of a closed surface: rings of points between two poles."""
    around = int(np.sqrt(triangles))
    rings = triangles // (2 * around)
    theta, phi = np.meshgrid(np.pi * np.arange(1, rings + 1) / (rings + 1), 2.0 * np.pi * np.arange(around) / around,
                             indexing="ij")  # fmt: skip
    (a, b), (k, m) = random.uniform(0.02, 0.06, 2), random.integers(2, 9, 2)
    radius = 1.0 + a * np.sin(k * theta) * np.cos(m * phi) + b * np.sin(theta) * np.cos(k * phi)
    ring = radius * np.array([np.sin(theta) * np.cos(phi), 0.6 * np.sin(theta) * np.sin(phi), 1.5 * np.cos(theta)])
    vertices = 0.06 * np.concatenate([ring.reshape(3, -1).T, [[0.0, 0.0, 1.5], [0.0, 0.0, -1.5]]])
    number = np.arange(rings * around).reshape(rings, around)
    here, beside = number, np.roll(number, -1, axis=1)
    quads = [x.ravel() for x in (here[:-1], here[1:], beside[:-1], beside[1:])]
    top, bottom = rings * around, rings * around + 1
    caps = [(np.full(around, top), here[0], beside[0]), (np.full(around, bottom), beside[-1], here[-1])]
    faces = [(quads[0], quads[1], quads[2]), (quads[2], quads[1], quads[3]), *caps]
    return vertices, np.concatenate([np.stack(corners, axis=1) for corners in faces])


def write_mesh(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Write an OBJ, or a binary STL."""
    if path.suffix == ".obj":
        lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices] + [f"f {a} {b} {c}" for a, b, c in faces + 1]
        path.write_text("\n".join(lines) + "\n")
        return
    rows = np.zeros(len(faces), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    rows["corners"] = vertices[faces]
    path.write_bytes(bytes(80) + len(faces).to_bytes(4, "little") + rows.tobytes())


def write_robot(folder: Path) -> Path:
    """Write an MJCF of a free base with five chains of hinges, each body with visual meshes; return its path."""
    random, names = np.random.default_rng(0), []
    for k, triangles in enumerate(np.linspace(LEAST, MOST, MESHES).astype(int)):
        names.append(f"mesh{k}.{('stl', 'obj')[k % 2]}")
        write_mesh(folder / names[-1], *bumpy_surface(int(triangles), random))

    def shown(meshes: range) -> str:
        return "".join(f'<geom type="mesh" mesh="m{k}" contype="0" conaffinity="0" group="2"/>' for k in meshes)

    limbs, first = "", MESHES - DOFS
    for chain in range(CHAINS):
        body = ""
        count = DOFS // CHAINS + (chain < DOFS % CHAINS)
        for link in reversed(range(count)):
            k, axis = first + link, ("1 0 0", "0 1 0", "0 0 1")[link % 3]
            body = f"""<body name="link{chain}_{link}" pos="{0.1 * (chain - 2) if link == 0 else 0} 0 -0.2">
<inertial pos="0 0 0" mass="1" diaginertia=".01 .01 .01"/><geom type="capsule" size=".03 .06" group="3"/>
<joint name="joint{chain}_{link}" axis="{axis}" range="-2 2" damping=".5" armature=".01"/>{shown(range(k, k + 1))}
{body}</body>"""
        limbs, first = limbs + body, first + count
    assets = "".join(f'<mesh name="m{k}" file="{name}"/>' for k, name in enumerate(names))
    path = folder / "h1_like.xml"
    path.write_text(f"""<mujoco model="h1_like"><asset>{assets}</asset>
<compiler angle="radian"/><worldbody><geom name="floor" type="plane" size="5 5 .1"/><body name="base" pos="0 0 2">
<freejoint name="base"/><inertial pos="0 0 0" mass="8" diaginertia=".1 .1 .1"/>{shown(range(MESHES - DOFS))}{limbs}
</body></worldbody></mujoco>""")
    return path


# --- seconds of one file ----------------------------------------------------------------------------------------------
def mjcf_models() -> list[Model]:
    """The MJCF files that load."""
    found = [path for path in mjcf_files.files() if mjcf_files.reason(path) is None]
    top = {package: next(p for f in found for p in f.parents if p.name == package) for package in mjcf_files.PACKAGES}
    package_of = {path: next(p for p in top.values() if p in path.parents) for path in found}
    return [Model(str(path.relative_to(package_of[path].parent)), path, {}) for path in found]


def urdf_models() -> list[Model]:
    """The URDF files that load."""
    found = [path for path in robot_files.files() if path.name not in robot_files.REFUSED]
    return [Model(robot_files.label(path), path, robot_files.options_of(path)) for path in found]


def load(model: Model) -> cvi.Scene:
    """Return the scene of a file, with the engine's."""
    scene = cvi.Scene((0.0, 0.0, 0.0))  # so that a short run is quiet
    if model.path.suffix == ".xml":
        scene.add_mjcf(model.path)
    else:
        scene.add_urdf(model.path, **model.options)
    scene.core()
    return scene


def save(scene: cvi.Scene, folder: Path) -> float:
    """Return the seconds of saving a short run; nan where nothing moves."""
    if scene.nv == 0:
        return float("nan")
    try:
        traj = cvi.simulate(scene, duration=0.02, dt=1e-3, throw=False)
    except cvi.ContactviError:
        return float("nan")
    return seconds(lambda: traj.save(folder / "run.npz", overwrite=True))[0]


def compile_by_mujoco(model: Model) -> None:
    """Compile a file by MuJoCo alone."""
    import mujoco

    if model.path.suffix == ".xml":
        mujoco.MjModel.from_xml_path(str(model.path))
        return
    mujoco.MjModel.from_xml_string(resolved_urdf(model.path))


def resolved_urdf(path: Path) -> str:
    """Return a URDF with absolute paths of meshes, as MuJoCo takes it."""
    from contactvi.importing.report import PartReport
    from contactvi.importing.urdf import read_urdf

    compiler = '<mujoco><compiler strippath="false" balanceinertia="true"/></mujoco>'
    return read_urdf(path, (), PartReport(""), False).xml.replace("</robot>", f"{compiler}</robot>")


def seconds(function: Callable[[], Any]) -> tuple[float, Any]:
    """Return the time that a call takes, and its result."""
    start = time.perf_counter()
    result = function()
    return time.perf_counter() - start, result


@contextmanager
def own_cache() -> Iterator[Path]:
    """Give contactvi an empty cache."""
    before = os.environ.get("CONTACTVI_CACHE")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["CONTACTVI_CACHE"] = f"{folder}/cache"
        try:
            yield Path(folder)
        finally:
            os.environ.pop("CONTACTVI_CACHE")
            if before is not None:
                os.environ["CONTACTVI_CACHE"] = before


def measured(model: Model, repeats: int) -> Row:
    """Return the seconds of a file, the least of the repeats."""
    found, reason, other = [], "", float("inf")
    for _ in range(repeats):
        with own_cache() as folder:
            cold, scene = seconds(lambda: load(model))
            save_cold = save(scene, folder)
            warm, scene = seconds(lambda: load(model))
            found.append((cold, warm, save_cold, save(scene, folder)))
        if not reason:
            try:
                other = min(other, seconds(lambda: compile_by_mujoco(model))[0])
            except ValueError as error:
                reason = str(error).strip().splitlines()[0]
    cold, warm, save_cold, save_warm = np.min(found, axis=0).tolist()
    return Row(model.label, float("nan") if reason else other, cold, warm, save_cold, save_warm, reason)


def measured_all(models: list[Model], repeats: int) -> list[Row]:
    """Measure files one by one; what only the first load imports is not counted."""
    import mujoco

    mujoco.mj_setCacheCapacity(mujoco.mj_getCache(), 0)
    mujoco.set_mju_user_warning(lambda text: None)  # which would be written to a file in the working folder
    rows = []
    load(models[0])
    for model in models:
        sys.stderr.write(f"{model.label}\n")
        try:
            rows.append(measured(model, repeats))
        except cvi.ContactviError as error:
            sys.stderr.write(f"refused: {error}\n")
    return rows


# --- tables -----------------------------------------------------------------------------------------------------------
def markdown(head: tuple[str, ...], cells: list[list[str]]) -> list[str]:
    """Return the lines of a table."""
    return ["| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *cells)]


def cells(row: Row) -> list[str]:
    """Return seconds and ratios of one file."""
    times = [f"{value:.3f}" for value in (row.mujoco, row.cold, row.warm, row.save_cold, row.save_warm)]
    return [f"`{row.label}`", *times, f"{row.cold / row.mujoco:.2f}", f"{row.warm / row.mujoco:.2f}"]


HEAD = (
    "file",
    "MuJoCo [s]",
    "cold [s]",
    "warm [s]",
    "save, cold [s]",
    "save, warm [s]",
    "cold / MuJoCo",
    "warm / MuJoCo",
)


def summary(title: str, rows: list[Row]) -> list[str]:
    """Return medians and the worst of a set, of all its files and of those that take MuJoCo long."""

    def line(name: str, chosen: list[Row]) -> list[str]:
        if not chosen:
            return [name, "0", *["-"] * 6]
        columns = np.array([row[1:6] for row in chosen], dtype=float)
        middle = [f"{value:.3f}" for value in np.nanmedian(columns, axis=0)[:3]]
        ratios = []
        for k in (1, 2):
            own = [float(c[k] / c[0]) for c in columns if np.isfinite(c[0])]
            ratios.append(f"{statistics.median(own):.2f}, {max(own):.2f}" if own else "-")
        return [
            name,
            str(len(chosen)),
            *middle,
            *ratios,
            f"{np.nanmax(columns[:, 3]):.2f}, {np.nanmax(columns[:, 4]):.2f}",
        ]

    slow = [row for row in rows if row.mujoco >= SLOW]
    head = (title, "files", "MuJoCo [s]", "cold [s]", "warm [s]", "cold / MuJoCo: median, worst",
            "warm / MuJoCo: median, worst", "longest save: cold, warm [s]")  # fmt: skip
    lines = markdown(head, [line("all", rows), line(f"MuJoCo takes {SLOW:g} s or more", slow)])
    refused = [row for row in rows if row.reason]
    if refused:
        lines += ["", f"MuJoCo cannot read {len(refused)} of them, which are in none of its columns:"]
        lines += [f"- {count} x {reason}" for reason, count in reasons(refused)]
    longest = max(rows, key=lambda row: row.cold)
    lines += ["", f"Longest cold load: {longest.label}, {longest.cold:.2f} s, warm {longest.warm:.3f} s"]
    return lines


def reasons(refused: list[Row]) -> list[tuple[str, int]]:
    """Return why MuJoCo refuses files, without names, the most frequent first."""
    texts = [re.sub(r"'[^']*'", "'...'", row.reason)[:100] for row in refused]
    return sorted(((text, texts.count(text)) for text in set(texts)), key=lambda item: -item[1])


def run_by_part(repeats: int) -> list[str]:
    """Return the table of `contactvi run`: the least of each part over the repeats, cold and warm."""
    lines = []
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        one_run(HANDS["Allegro hand"], folder, folder / "first")  # compiles the modules
        for name, model in HANDS.items():
            cold = [one_run(model, folder, folder / f"{name} {k}") for k in range(repeats)]
            warm = [one_run(model, folder, folder / f"{name} 0") for _ in range(repeats)]
            for state, runs in (("cold", cold), ("warm", warm)):
                least = [min(run.get(part, float("nan")) for run in runs) for part in (*PARTS, "all")]
                lines.append([f"{name}, {state}", *(f"{value:.2f}" for value in least)])
    return markdown(("", *PARTS, "all"), lines)


def one_run(model: str, folder: Path, cache: Path) -> dict[str, float]:
    """Return the seconds of `contactvi run` by part, as it prints them, and of the process."""
    command = [sys.executable, "-c", RUN, "run", model, "-o", str(folder / "run"), "--duration", "0.1"]
    given = {"CONTACTVI_CACHE": str(cache), "COLUMNS": "200"}
    given |= {"PYTHONPYCACHEPREFIX": str(folder / "modules"), "PYTHONDONTWRITEBYTECODE": ""}  # as if installed
    took, done = seconds(lambda: subprocess.run(command, capture_output=True, text=True, env=os.environ | given))
    found = re.findall(r"(\w+) ([\d.e+-]+) s", next(line for line in done.stdout.splitlines() if "imports" in line))
    return {name: float(value) for name, value in found} | {"all": took}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=3, help="of each number, the least of which counts")
    parser.add_argument("--only", choices=("h1", "mjcf", "urdf", "run"), help="one of the parts")
    parser.add_argument("--match", default="", help="files with this text in their names")
    parser.add_argument("--all", action="store_true", help="print each file")
    parser.add_argument("-o", "--output", type=Path, help="folder for the robot that is written")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    wanted = [arguments.only] if arguments.only else ["h1", "mjcf", "urdf", "run"]
    if "h1" in wanted:
        with tempfile.TemporaryDirectory() as made:
            folder = arguments.output or Path(made)
            folder.mkdir(parents=True, exist_ok=True)
            path = write_robot(folder)
            rows = measured_all([Model("h1_like.xml", path, {})], arguments.repeats)
        print("\n".join(["", *markdown(HEAD, [cells(row) for row in rows])]), flush=True)
    for name, models in (("mjcf", mjcf_models), ("urdf", urdf_models)):
        if name in wanted:
            rows = measured_all([model for model in models() if arguments.match in model.label], arguments.repeats)
            print("\n".join(["", *summary(name, rows)]))
            if arguments.all:
                print("\n".join(["", *markdown(HEAD, [cells(row) for row in rows])]), flush=True)
    if "run" in wanted:
        print("\n".join(["", *run_by_part(arguments.repeats)]), flush=True)


if __name__ == "__main__":
    main()
