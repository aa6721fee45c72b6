"""Scene files: one readable TOML page with what is simulated, how it starts and how it is run.

    [scene]                 gravity = [0, 0, -9.81]                 title, description: for the reader
                            order = ["box", "sphere", ...]: the sections of the parts, in which order they are added
                            camera = "auto" | "front" | "side" | "top" | { eye = [x, y, z], target = [x, y, z] } |
                            { follow = "body" }
    [[urdf]]                path, base = "fixed" | "free", xyz, rpy, package_dirs, srdf, prefix, limits = true,
                            friction = false, mimic = true, armature = number | { joint = number },
                            self_collision = true, contact_friction = false,
                            shape = "hull" | "pieces" | "field" | { name = shape }, spacing
    [[mjcf]]                path, xyz, rpy, prefix, limits = true, friction = false, equality = true, actuators = true,
                            restitution = 0 | number | "solref", self_collision = true, allow = [] | ["flex"],
                            turning_friction = false, hfield = "prisms" | "smooth", shape, spacing
    [[sphere]]              name, radius, mass, free = true, xyz, rpy, color
    [[box]]                 name, size, ...       [[capsule]], [[cylinder]]  name, radius, length, ...
    [[ellipsoid]]           name, radii, ...
    [[mesh]]                name, path, mass | density, scale, decompose = false | true | number,
                            spacing, ...
    [[halfspace]]           normal, offset, name, color
    [[heightfield]]         name, heights = [[...], ...] | path, size = [x, y], height, smooth = true, xyz, rpy, color
    [contact]               restitution, friction (defaults), disable = [["a", "b"]], enable = [["a", "b"]]
    [[contact.body]]        name, restitution, friction             of one body, part or geometry
    [[contact.pair]]        a, b, restitution, friction
    [[joint]]               name (patterns such as "joint_*" allowed), stiffness, rest, damping, limits, restitution,
                            friction, spring = [k1, k2, ...], armature, gear_ratio, rotor_inertia
    [[point]], [[distance]] a, b, point_a, point_b, name; [[distance]] also length
    [[weld]], [[screw]]     a, b, name; [[weld]] xyz, rpy; [[screw]] pitch, frame_a, frame_b = { xyz, rpy }
    [[equality]]            joint, other, coefficients = [c0, c1, ...], name
    [[prescribe]]           joint (or a free body), motion, name
    [[compliance]]          a, b, stiffness, exponent, damping, friction, slip_speed     as Scene.set_compliance
    [[surface_velocity]]    a, linear, angular, profile             as Scene.set_surface_velocity
    [[spring]]              a, b, point_a, point_b, stiffness, rest_length, damping, tension_only, name
    [[tape_spring]]         points = [["body", [x, y, z]], ...], and the rest of [[spring]]
    [[wrench]]              body, force, torque, point, axes = "world" | "body", name
    [[servo]], [[actuator]] joint; [[servo]] kp, kd, effort, target; [[actuator]] effort, velocity = true | number
    [initial]               configuration = a name in the models' files (keyframe, group state), q = { joint = value },
                            v = { joint = value }, springs_at_rest = true | false,
                            assemble = true | false (the nearest start on the constraints)
    [[initial.body]]        name, xyz, rpy or quaternion, velocity, angular_velocity    of a free body
    [run]                   dt = number | "auto", duration, order, tol, solver_tol, impact, mhc_reference, sample_dt,
                            record_every, dense, dt_contact, zeno, support, ...   (options.Options)
    [run.ledger]            own_jump = 1e-10, ...                   tolerances (contactvi.trajectory.ledger)

SI units and radians; rpy is roll-pitch-yaw as in URDF, a quaternion is (x, y, z, w), velocities are in world axes.
Relative paths are relative to the file; `example-robot-data://robots/...` and `package://...` are understood. Parts are
added in the order of the list above, then file order, unless [scene] order says otherwise. Without [initial] the scene
starts at rest in its neutral pose; springs_at_rest starts every joint that has a spring where the spring rests.
Motions, lengths and targets are numbers or { times = [...], values = [...] }, of a body 7 numbers or { times, poses };
the elements are those of Scene.add_point and its siblings. Where entries set one thing twice the later one counts. An
unknown key is an error. `Scene.save` writes such a file.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

from contactvi.errors import SceneError
from contactvi.importing.paths import resolve_path, unreadable
from contactvi.scene.notes import notes_of_file
from contactvi.scene.scene import GRAVITY, Scene
from contactvi.scene.toml_entries import fill
from contactvi.scene.toml_tables import check_keys

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """Return the scene of a TOML file, with its start in .q0 (nq,), .v0 (nv,) and its run settings in .settings.

    Raises:
        SceneError: no such file, not TOML, unknown or missing keys.
        ContactviError: whatever the scene itself refuses, with the place in the file.
    """
    file = resolve_path(path)
    data = _read(file)
    check_keys(data, file)
    scene = Scene(data.get("scene", {}).get("gravity", GRAVITY))
    fill(scene, data, file)
    scene.note(notes_of_file(data, file.parent))
    return scene


def _read(file: Path) -> dict[str, Any]:
    try:
        text = file.read_text(encoding="utf-8")
        _refuse_model(file, text)
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        remedy = "Correct it there; strings stand in quotes, lists in square brackets"
        if isinstance(error, UnicodeDecodeError):
            remedy = "Name a scene file (.toml); contactvi play shows a stored run (.npz)"
        raise SceneError(
            f"{file.name} is not TOML", path=file, expected="a TOML file", got=str(error), remedy=remedy
        ) from None
    except RecursionError:
        raise SceneError(
            f"{file.name} is nested too deeply",
            path=file,
            expected="a scene file",
            got="values in values",
            remedy="Write it without lists in lists",
        ) from None
    except (OSError, ValueError) as error:
        raise unreadable(file, error) from None


def _refuse_model(file: Path, text: str) -> None:
    """Raise SceneError for a robot model in the place of a scene file; the remedy is the scene file that loads it."""
    if text.lstrip("\ufeff \t\r\n")[:9].lower() in ("<!doctype", "<html"):
        raise SceneError(
            f"{file.name} is a page, not a scene", path=file, expected="a scene file (.toml)", got="HTML",
            remedy="Open it in a browser, or name the scene file of its run",
        )  # fmt: skip
    if not text.lstrip("\ufeff \t\r\n").startswith("<") and file.suffix.lower() not in (".urdf", ".mjcf", ".xml"):
        return
    section, got = ("mjcf", "an MJCF") if "<mujoco" in text or file.suffix.lower() == ".mjcf" else ("urdf", "a URDF")
    names = (f"{file.stem}.toml", f"{file.stem}_scene.toml")
    name = next((name for name in names if not (file.parent / name).is_file()), "a scene file")
    lines = [f"[[{section}]]", f'path = "{file.name}"', "", "[run]", "dt = 1e-3", "duration = 1.0"]
    raise SceneError(
        f"{file.name} is a model, not a scene",
        path=file,
        expected="a scene file (.toml)",
        got=got,
        remedy=f"Write these lines to {name} beside it, and load that:\n\n" + "\n".join(lines),
    )
