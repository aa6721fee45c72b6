"""Robot models in the place of scene files: what has to be assumed to run one, and the scene file that says it.

A model says neither how it starts nor what is around it. A model whose trees are all free is dropped on a plane; one
that is fixed to the world is held, and its joints move limp. Each assumption has a line that is printed and a line of
the scene file, so that what was run can be changed.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from rich.markup import escape

from contactvi.commands.console import out
from contactvi.errors import InputError, SeparationError, UnusedSettingWarning
from contactvi.files import write_atomic
from contactvi.importing.paths import resolve_path
from contactvi.importing.xml import read_xml
from contactvi.inputs import real
from contactvi.scene.scene import GRAVITY, Scene
from contactvi.scene.separation import LIMIT
from contactvi.scene.toml import load_scene
from contactvi.scene.toml_text import toml_page, value_in_file
from contactvi.tables import name_table, print_table

MODEL_ENDINGS = (".urdf", ".xml", ".mjcf")
ENDINGS = (*MODEL_ENDINGS, ".toml")
HEIGHT, DURATION, DT = 0.05, 2.0, 1e-3  # of a drop [m], of a run [s], of a step [s]
RESTITUTION, FRICTION = 0.0, 0.8
_FREE = {"floating": "free", "fixed": "fixed"}  # types of an SRDF's virtual joint


class Choice(NamedTuple):
    """What the command line says of a model; None is left to the file.

    Attributes:
        base: "fixed" or "free", of a URDF. package_dirs: where package:// is looked for. srdf: its SRDF.
        allow: kinds of elements of an MJCF that are refused otherwise.
        configuration: name of the start in the model's files. height: of a drop [m]; HEIGHT, or
            where the file has surroundings none.
        shape: of meshes, "hull", "pieces" or "field" for all, or NAME=SHAPE. spacing: of fields [m].
    """

    base: str | None = None
    package_dirs: Sequence[str] = ()
    srdf: str | None = None
    configuration: str | None = None
    height: float | None = None
    allow: Sequence[str] = ()
    shape: Sequence[str] = ()
    spacing: float | None = None

    def meshes(self) -> dict[str, Any]:
        """Return `shape` and `spacing` as Scene.add_urdf takes them, where they are given."""
        pairs = [entry.rpartition("=")[::2] for entry in self.shape]
        shape = pairs[0][1] if len(pairs) == 1 and not pairs[0][0] else {name or "*": kind for name, kind in pairs}
        found = {"shape": shape or None, "spacing": self.spacing}
        return {name: value for name, value in found.items() if value is not None}


@dataclass
class ModelScene:
    """A model as a scene that can be run, and what was assumed for it.

    Attributes:
        scene: with its start and its settings.
        assumed: name and text of each assumption, as they are printed.
        tables: the sections of the scene file: header and keys.
    """

    scene: Scene
    assumed: list[tuple[str, str]] = field(default_factory=list)
    tables: list[tuple[str, dict[str, Any]]] = field(default_factory=list)

    def save(self, path: Path, settings: Mapping[str, Any], overwrite: bool) -> Path:
        """Write the scene file that says what was assumed, with these settings of the run; return its path."""
        folder = path.resolve().parent
        run = {**self.scene.settings, **{name: value for name, value in settings.items() if value is not None}}
        text = toml_page("Written by contactvi run --save-scene.", [*self.tables, ("[run]", run)], folder)
        return write_atomic(path, lambda file: file.write(text.encode()), overwrite)


def choice_of(given: Mapping[str, Any]) -> Choice:
    """Return what the command line says of a model; None is not given."""
    return Choice(**{name: value for name, value in given.items() if value is not None})


def scene_to_run(
    file: str, given: Mapping[str, Any], save_scene: Path | None, settings: Mapping[str, Any], force: bool
) -> Scene:
    """Return the scene of a scene file, or of a model, whose assumptions are printed and saved.

    Args:
        given: fields of `Choice`, None where they are not given. settings: of the run, None where they are not given.

    Raises:
        ContactviError: as load_scene and model_scene; options of models with a scene file.
    """
    if is_model(file):
        found = model_scene(file, choice_of(given))
        print_assumed(file, found)
        if save_scene is not None:
            out.print(f"Scene file: {escape(str(found.save(save_scene, settings, force)))}")
        out.print()
        return found.scene
    for name, value in {**given, "save_scene": save_scene}.items():
        if value is not None:
            raise InputError(
                f"--{name.replace('_', '-').removesuffix('s')} is of models", name=name,
                expected="a URDF or MJCF with it", got=file, remedy="A scene file says it itself: leave the option out",
            )  # fmt: skip
    return load_scene(file)


def print_assumed(file: str, found: ModelScene) -> None:
    """Print what is assumed of a model, and how to change it."""
    settings = found.scene.settings
    run = ("run", f"{settings['duration']:g} s in steps of {settings['dt']:g} s, unless --duration, --dt, ... differ")
    out.print(f"Assumed of {escape(Path(file).name)}; contactvi run ... --save-scene SCENE.toml writes it down:")
    print_table(out, name_table([*found.assumed, run]))


def is_model(path: str) -> bool:
    """Return whether a file is a robot model by its ending, not a scene file."""
    return Path(path).suffix.lower() in MODEL_ENDINGS


def read_scene(path: str, choice: Choice) -> Scene:
    """Return the scene of a scene file or of a model, without what is around a model.

    Raises:
        ContactviError: a file of another kind, and whatever the model itself is refused for.
    """
    ending = Path(path).suffix.lower()
    if ending not in ENDINGS:
        raise InputError(
            f"{path!r} is neither a model nor a scene file",
            name="file",
            expected="a file ending in " + ", ".join(ENDINGS),
            got=repr(ending) if ending else "no ending",
            remedy="Name such a file; a model of another format has to be converted to URDF first",
        )
    return load_scene(path) if ending == ".toml" else _read_model(path, choice).scene


def model_scene(path: str, choice: Choice) -> ModelScene:
    """Return a model as a scene that can be run.

    Raises:
        ContactviError: as read_scene; the engine refuses the scene; an unknown configuration.
    """
    height = None if choice.height is None else real("height", choice.height, 0.0)
    found = _read_model(path, choice)
    scene = found.scene
    if scene.nv == 0:
        raise InputError(
            "Nothing in the model moves",
            name="file",
            expected="joints, or a free base",
            got=f"{len(scene.parts[0].bodies)} bodies fixed to the world",
            remedy="Give it joints; --base free lets a URDF move away",
        )
    free = all(_is_free(joint) for joint in _roots(scene.model))
    surroundings = any(shape.parentJoint == 0 for shape in scene.collision_model.geometryObjects)
    if free and not surroundings:
        scene.add_halfspace(name=_ground_name(scene))
        found.tables.append(("[[halfspace]]", {"name": scene.parts[-1].name}))
    _assume_contact(found, is_ours=found.tables[0][0] == "[[urdf]]")
    _assume_start(found, choice)
    if free:
        _lift(found, height, surroundings)
    else:
        found.assumed.append(("ground", "none is added: the model is held" + _unused(height)))
    _end_overlaps(found)
    servos = scene.servo_joints
    held = f"servos of the file hold {len(servos)} at the start, the others are limp" if servos else "limp"
    found.assumed.append(("joints", held))
    found.scene.settings = {"dt": DT, "duration": DURATION}
    return found


def _read_model(path: str, choice: Choice) -> ModelScene:
    if _root_tag(path) == "mujoco":
        return _read_mjcf(path, choice)
    if choice.allow:
        raise InputError(
            "--allow is of MJCF files", name="allow", expected="an MJCF with it", got="a URDF",
            remedy="Leave it out: a URDF has no deformable bodies",
        )  # fmt: skip
    base, why = _base(path, choice)
    scene = Scene()
    scene.add_urdf(path, base=base, package_dirs=choice.package_dirs, srdf=choice.srdf, **choice.meshes())
    keys: dict[str, Any] = {"path": path, "base": base, **choice.meshes()}
    if choice.package_dirs:
        keys["package_dirs"] = list(choice.package_dirs)
    if choice.srdf is not None:
        keys["srdf"] = choice.srdf
    return ModelScene(scene, [("base", f"{base}, {why}")], [("[[urdf]]", keys)])


def _read_mjcf(path: str, choice: Choice) -> ModelScene:
    for name, value in (("--base", choice.base), ("--srdf", choice.srdf)):
        if value is not None:
            raise InputError(
                f"{name} is of URDF files", name=name.removeprefix("--"), expected="a URDF with it", got="an MJCF",
                remedy="Leave it out: an MJCF says which of its bodies are free, and has keyframes",
            )  # fmt: skip
    scene = Scene.from_mjcf(path, allow=choice.allow, **choice.meshes())
    keys: dict[str, Any] = {"path": path, **choice.meshes()}
    if choice.allow:
        keys["allow"] = list(choice.allow)
    tables: list[tuple[str, dict[str, Any]]] = [("[[mjcf]]", keys)]
    if not np.array_equal(scene.gravity, GRAVITY):
        tables.append(("[scene]", {"gravity": scene.gravity.tolist()}))
    roots = _roots(scene.model)
    free = sum(map(_is_free, roots))
    return ModelScene(scene, [("base", f"as the file says: {free} of {len(roots)} moving trees are free")], tables)


def _root_tag(path: str) -> str:
    """Return the tag that a model begins with; where it cannot be read, that of its ending."""
    if Path(path).suffix.lower() != ".xml":
        return "robot" if path.lower().endswith(".urdf") else "mujoco"
    try:
        _, root = next(ElementTree.iterparse(resolve_path(path), events=("start",)))
    except (ElementTree.ParseError, OSError, ValueError, LookupError, StopIteration):
        return "mujoco"  # its reader says what is wrong
    return "robot" if root.tag == "robot" else "mujoco"


def _base(path: str, choice: Choice) -> tuple[str, str]:
    """Return the base of a URDF, and why."""
    if choice.base is not None:
        return choice.base, "as --base says"
    if choice.srdf is not None:
        joint = read_xml(resolve_path(choice.srdf), "robot", "an SRDF").find("virtual_joint")
        if joint is not None and joint.get("type") in _FREE:
            return _FREE[str(joint.get("type"))], "as the virtual joint of the SRDF says"
    return "fixed", "as nothing in a URDF says otherwise; --base free lets it move away"


def _roots(model: pin.Model) -> list[pin.JointModel]:
    """Return the joints that hang at the world."""
    return [model.joints[i] for i in range(1, model.njoints) if model.parents[i] == 0]


def _is_free(joint: pin.JointModel) -> bool:
    return str(joint.shortname()) == "JointModelFreeFlyer"


def _ground_name(scene: Scene) -> str:
    taken = {*scene.names.bodies, *scene.names.geometries, *scene.names.joints, *(part.name for part in scene.parts)}
    return next(name for name in ("ground", *(f"ground{k}" for k in range(2, 10**6))) if name not in taken)


def _assume_contact(found: ModelScene, is_ours: bool) -> None:
    """Set the defaults of contacts, where the file, an MJCF, leaves them open."""
    keys: dict[str, Any] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("error", UnusedSettingWarning)
        with contextlib.suppress(UnusedSettingWarning):
            found.scene.set_contact(restitution=RESTITUTION)
            keys["restitution"] = RESTITUTION
        with contextlib.suppress(UnusedSettingWarning):
            found.scene.set_contact(friction=FRICTION)
            keys["friction"] = FRICTION
    found.tables.append(("[contact]", keys))
    text = ", ".join(f"{name} {value:g}" for name, value in keys.items())
    ours = text if is_ours else f"as the file says; what it leaves open: {text}"
    found.assumed.append(("contact", ours if keys else "as the file says"))


def _assume_start(found: ModelScene, choice: Choice) -> None:
    scene, named = found.scene, list(found.scene.named_configurations)
    others = f"; the files also have {', '.join(named[:6])}" if named else ""
    if choice.configuration is None:
        scene.q0 = scene.neutral()
        found.assumed.append(("start", f"joints at zero or the nearest limit, at rest{others}"))
        return
    scene.q0 = scene.configuration({}, choice.configuration)
    scene.v0 = scene.named_configurations[choice.configuration][1]
    found.assumed.append(("start", f"{choice.configuration!r} of the model's files"))
    found.tables.append(("[initial]", {"configuration": choice.configuration}))


def _unused(height: float | None) -> str:
    return "" if height is None else "; --height is not used"


def _lift(found: ModelScene, height: float | None, surroundings: bool) -> None:
    """Raise the free trees until the lowest shape is `height` above the plane.

    Without a height, with surroundings only if they overlap.

    The gaps to a plane change with the height, one to one.
    """
    scene = found.scene
    still = {shape.name for shape in scene.collision_model.geometryObjects if shape.parentJoint == 0}
    gaps = np.asarray(scene.core().gaps(scene.q0)[0])
    near = [gap for pair, gap in zip(scene.pair_names, gaps, strict=True) if still & set(pair)]
    where = "of the file" if surroundings else "a plane at z = 0"
    if not near:
        found.assumed.append(("ground", f"{where}; no shape of the model can touch it{_unused(height)}"))
        return
    least = float(min(near))
    if height is None and surroundings and least >= 0.0:
        found.assumed.append(("ground", f"{where}, {least:.3g} m below"))
        return
    if height is None and surroundings and -least <= LIMIT:
        found.assumed.append(("ground", f"{where}, {-least:.3g} m in it"))  # `_end_overlaps` moves it out
        return
    height = HEIGHT if height is None else height
    values = {}
    assert scene.q0 is not None
    for i in range(1, scene.model.njoints):
        if scene.model.parents[i] == 0:
            name = str(scene.model.names[i])
            place = scene.q0[scene.q_index(name)].copy()
            place[2] += height - least
            values[name] = place.tolist()
    scene.q0 = scene.configuration(values, scene.q0)
    found.tables.append(("[initial.q]", values))
    found.assumed.append(("ground", f"{where}, {height:g} m below the lowest shape"))


def _end_overlaps(found: ModelScene) -> None:
    """Move the start apart; where that is not possible within the limits, leave out pairs of the model itself."""
    error = _move_apart(found)
    if error is not None and _take_out_overlaps(found):
        error = _move_apart(found)
    if error is not None:
        found.assumed.append(("overlaps", f"left, so that the start is refused: {error.what}, {error.got}"))


def _move_apart(found: ModelScene) -> SeparationError | None:
    """Move the start apart by the least; return the error where that is not possible."""
    scene = found.scene
    assert scene.q0 is not None
    try:
        moved = scene.separate(scene.q0)
    except SeparationError as error:
        return error
    if not moved.overlaps:
        return None
    values = {}
    for joint, name in zip(list(scene.model.joints)[1:], list(scene.model.names)[1:], strict=True):
        own = slice(joint.idx_q, joint.idx_q + joint.nq)
        if not np.array_equal(moved.q[own], scene.q0[own]):
            values[str(name)] = value_in_file(joint, moved.q[own])
    scene.q0 = scene.configuration(values, scene.q0)
    initial = next((keys for header, keys in found.tables if header == "[initial.q]"), None)
    if initial is None:
        found.tables.append(("[initial.q]", values))
    else:
        initial.update(values)
    (a, b), depth = next(iter(moved.overlaps.items()))
    more = f" and {len(moved.overlaps) - 1} more" if len(moved.overlaps) > 1 else ""
    text = f"{a} | {b} overlapped by {depth:.3g} m{more}; the start was moved: {moved.text()}"
    found.assumed.append(("overlaps", text))
    return None


def _take_out_overlaps(found: ModelScene) -> bool:
    """Leave out the pairs of the model itself that overlap at its start; return whether there are some."""
    pairs = found.scene.disable_overlapping(found.scene.q0)
    if not pairs:
        return False
    contact = next(keys for header, keys in found.tables if header == "[contact]")
    contact["disable"] = [list(pair) for pair in pairs]
    listed = ", ".join(f"{a} | {b}" for a, b in pairs[:3]) + (f" and {len(pairs) - 3} more" if len(pairs) > 3 else "")
    found.assumed.append(("overlaps", f"pairs of the model that overlap at the start, left out: {listed}"))
    return True
