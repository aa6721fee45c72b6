"""Find model and mesh files without a hard-coded prefix.

A file may be given as a plain path, as `file://...`, as `example-robot-data://robots/...` (the data package installed
beside pin) or as `package://name/...`. A package is looked for, in this order, in the caller's `package_dirs`, in the
ancestors of the file that mentions it, in ROS_PACKAGE_PATH, and in the share folder of example-robot-data.
"""

from __future__ import annotations

import functools
import importlib.metadata
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree

from contactvi.errors import InputError, SceneError, nearest
from contactvi.files import as_a_path

ROBOT_DATA = "example-robot-data"
_ENDINGS = (".urdf", ".xml", ".mjcf", ".toml")
_NO_MODELS = ("pyproject.toml", "package.xml")  # endings of models and scenes, other contents
_SIMILAR = 0.6  # difflib's measure from which a name is taken for a misspelt one


@functools.lru_cache(maxsize=1)
def example_robot_data_share() -> Path:
    """Return the share folder that contains `example-robot-data/robots`, in any layout of the installation.

    Raises:
        SceneError: the distribution example-robot-data is not installed or has no such folder.
    """
    remedy = "pip install example-robot-data"
    try:
        distribution = importlib.metadata.distribution(ROBOT_DATA)
    except importlib.metadata.PackageNotFoundError:
        raise SceneError(
            "The robot models of example-robot-data are not installed",
            remedy=remedy,
            expected="the distribution example-robot-data",
            got="none",
        ) from None
    for file in distribution.files or ():
        if str(file).endswith(f"share/{ROBOT_DATA}/package.xml"):
            return Path(str(distribution.locate_file(file))).resolve().parents[1]
    raise SceneError(
        "example-robot-data is installed without its robot models",
        remedy=remedy,
        expected="share/example-robot-data in the distribution",
        got="none",
    )


MOST_BYTES = 500_000_000  # of a model, scene or mesh: read and parsed it takes some ten times as much memory


def resolve_path(path: str | os.PathLike[str], base: Path | None = None, package_dirs: Sequence[object] = ()) -> Path:
    """Return the absolute path of an existing file.

    Args:
        path: plain path, `file://`, `example-robot-data://robots/...` or `package://name/...`.
        base: folder to which a relative path belongs; the working directory when None.

    Raises:
        InputError: not a path.
        SceneError: no such file, or a folder.
    """
    with as_a_path(path):
        return _path(path, base, package_dirs)


def _path(path: str | os.PathLike[str], base: Path | None, package_dirs: Sequence[object]) -> Path:
    if not isinstance(path, (str, os.PathLike)) or not str(path):
        raise InputError(
            "Path of a file",
            name="path",
            expected="a non-empty str or Path",
            got=repr(path),
            remedy="Give the path of a URDF, MJCF or scene file, such as 'models/robot.urdf'",
        )
    text = os.fspath(path)
    if "\0" in str(text):
        raise InputError(
            "Path of a file",
            name="path",
            expected="a path without zero bytes",
            got=repr(path),
            remedy="Remove the zero byte from the path",
        )
    scheme, _, rest = text.partition("://")
    if scheme == ROBOT_DATA and rest:
        found = example_robot_data_share() / ROBOT_DATA / rest
    elif scheme in ("package", "model") and rest:
        return resolve_resource(text, base or Path.cwd(), package_dirs)
    elif scheme == "file" and rest:
        found = Path(unquote(rest))
    else:
        found = (base or Path.cwd()) / Path(text).expanduser()
    found = found.resolve()
    check_is_file(found, text)
    return found


def check_is_file(found: Path, text: str) -> None:
    """Raise a SceneError unless `found` is an existing file; `text` is the path as the user wrote it."""
    if found.is_dir():
        inside = sorted(p.name for p in found.iterdir() if p.suffix in (".urdf", ".xml", ".toml"))
        hint = f"Files in it: {', '.join(inside[:8])}" if inside else "Name a file in it"
        if (found / "trajectory.npz").is_file():
            hint = f"It has a stored run: contactvi play {text} shows it, cvi.load reads it"
        raise SceneError("Not a file", path=found, expected="a file", got=f"the folder {text}", remedy=hint)
    if found.exists() and not found.is_file():
        raise SceneError(
            "Not a file",
            path=found,
            expected="a regular file",
            got=f"{text}, a device, a pipe or another special file",
            remedy="Copy its contents to a file",
        )
    if not found.is_file():
        raise SceneError("No such file", path=found, expected="an existing file", got=text, remedy=_similar(found))
    size = found.stat().st_size
    if size > MOST_BYTES:
        raise SceneError(
            "The file is too large",
            path=found,
            expected=f"at most {MOST_BYTES / 1e6:g} MB",
            got=f"{size / 1e6:.4g} MB",
            remedy="Split the model into several files, and simplify its meshes",
        )


def _similar(missing: Path) -> str:
    """Return which file or folder may be meant by one that is not there."""
    folder = next((p for p in missing.parents if p.is_dir()), Path("/"))
    entries = sorted(folder.iterdir()) if os.access(folder, os.R_OK) else []
    if folder != missing.parent:
        part = missing.relative_to(folder).parts[0]
        near = nearest(part, [p.name for p in entries if p.is_dir()], _SIMILAR)
        return (
            f"Did you mean {str(folder / near)!r}?" if near else f"Correct {part!r}: it is not in the folder {folder}"
        )
    suffixes = {missing.suffix.lower(), *_ENDINGS}
    files = [p for p in entries if p.suffix.lower() in suffixes and p.name not in _NO_MODELS and p.is_file()]
    stems: dict[str, Path] = {}
    for file in files:  # where two files differ in their endings only, the ending of the missing one counts
        if file.stem not in stems or file.suffix == missing.suffix:
            stems[file.stem] = file
    near = nearest(missing.stem, stems, _SIMILAR)
    if near is not None:
        return f"Did you mean {str(stems[near])!r}?"
    same = [p.name for p in files if p.suffix.lower() == missing.suffix.lower()]
    if same:
        return f"Name one of the files in {folder}: {', '.join(same[:8])}" + (", ..." if len(same) > 8 else "")
    return f"Correct the path: the folder {folder} has no {missing.suffix + ' ' if missing.suffix else ''}file like it"


def mesh_error(path: object, error: BaseException, name: str) -> SceneError:
    """Return the error of a mesh file that its reader, coal's or Pinocchio's, gives up; name: its geometry, or ""."""
    of = f" of geometry {name!r}" if name else ""
    return SceneError(
        f"Cannot read the mesh {path}{of}",
        path=path,
        body=name or None,
        got=reason_of(error),
        expected="a mesh file in a format that it reads: STL, OBJ, DAE or PLY",
        remedy="Export it again as STL or OBJ from a viewer of meshes, or replace it by a box or a sphere",
    )


def reason_of(error: BaseException) -> str:
    """Return what an exception of a library says in one line, without the places in its sources that come first."""
    lines = [line.strip() for line in str(error).splitlines()]
    told = [line for line in lines if line and not line.startswith("Hint")]
    return (told[-1].removeprefix("message: ") if told else type(error).__name__).rstrip(". ")


def unreadable(path: Path, error: Exception) -> SceneError:
    """Return the error for a file that is not there, or cannot be read."""
    expected, got, remedy = "a file that can be read", str(error), "Look at its permissions, or choose another file"
    if isinstance(error, FileNotFoundError):
        got, remedy = f"there is none in {path.absolute().parent}", "Correct the path"
    return SceneError(f"Cannot read {path}", path=path, expected=expected, got=got, remedy=remedy)


def _package_name(folder: Path) -> str | None:
    """Return the name in the package.xml of `folder`, if there is one."""
    manifest = folder / "package.xml"
    if not manifest.is_file():
        return None
    try:
        return (ElementTree.parse(manifest).getroot().findtext("name") or "").strip() or None
    except ElementTree.ParseError:
        return None


def _is_package(folder: Path, name: str) -> bool:
    return folder.name == name or _package_name(folder) == name


def package_candidates(name: str, start: Path, package_dirs: Sequence[object] = ()) -> Iterator[Path]:
    """Yield existing folders that may be package `name`, the most trusted first.

    `start` is the folder of the file that mentions the package.
    """
    ros_path = [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
    given = [Path(str(p)).expanduser() for p in package_dirs]
    ancestors = [start, *start.parents]
    for folder in given + ancestors + ros_path:
        if _is_package(folder, name):
            yield folder
        if (folder / name).is_dir():
            yield folder / name
    for folder in ros_path:  # A workspace may nest its packages one level deeper.
        yield from sorted(folder.glob(f"*/{name}")) if folder.is_dir() else ()
    try:
        share = example_robot_data_share()
    except SceneError:
        return
    for folder in (share / name, share / ROBOT_DATA / "robots" / name):
        if folder.is_dir():
            yield folder


def resolve_resource(url: str, start: Path, package_dirs: Sequence[object] = ()) -> Path:
    """Return the file that a mesh (or other) reference inside a model file means.

    Args:
        url: as written in the file: `package://`, `model://`, `file://`, `example-robot-data://`, or a path.
        start: folder of the file that mentions it.

    Raises:
        SceneError: no such file; the message lists the folders that were tried.
    """
    with as_a_path(url):
        return _resource(url, start, package_dirs)


def _resource(url: str, start: Path, package_dirs: Sequence[object]) -> Path:
    scheme, separator, rest = url.partition("://")
    tried: list[Path] = []
    if not separator:
        folders = [start, *(Path(str(p)).expanduser() for p in package_dirs)]
        candidates: Iterable[Path] = [folder / url for folder in folders]
    elif scheme in ("package", "model"):
        package, _, inside = rest.partition("/")
        candidates = (folder / inside for folder in package_candidates(package, start, package_dirs))
    elif scheme == "file":
        candidates = [Path(rest)]
    elif scheme == ROBOT_DATA:
        candidates = [example_robot_data_share() / ROBOT_DATA / rest]
    else:
        raise SceneError(
            f"Cannot read {url!r}",
            path=url,
            expected="package://, file://, example-robot-data:// or a path",
            got=f"{scheme}://",
            remedy="Download the file and name its path",
        )
    for candidate in candidates:
        for path in (candidate, Path(unquote(str(candidate)))):
            if path.is_file():
                return path.resolve()
        tried.append(candidate)
    where = ", ".join(str(p) for p in tried)
    nowhere = f"no package of that name in package_dirs, above {start}, in ROS_PACKAGE_PATH or in {ROBOT_DATA}"
    raise SceneError(
        f"No such file: {url}",
        path=url,
        expected="an existing file",
        got=f"nothing at {where}" if tried else nowhere,
        remedy="Pass package_dirs=[folder that contains the package]"
        if scheme in ("package", "model") and separator
        else "Put the file there, or correct the reference in the model",
    )
