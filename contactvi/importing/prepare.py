"""What is done with every model that becomes a part: checks, convex hulls, the report, and where it starts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin

from contactvi.errors import SceneError
from contactvi.importing.checks import check_joints, check_numbers, check_size, describe_model
from contactvi.importing.hulls import describe
from contactvi.importing.joint_kinds import has_limits
from contactvi.importing.mesh_choices import MeshChoice, take_meshes
from contactvi.importing.mesh_hulls import MeshHulls, prepare_geometry
from contactvi.importing.part import Part
from contactvi.importing.report import GeometryRow, PartReport


class reported:
    """Attach file and report to an error that leaves the block, so that `contactvi check` can still print them."""

    def __init__(self, report: PartReport, file: Path | None = None) -> None:
        self.report = report
        self.file = file

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, SceneError):
            if not any(note.use == "refused" for note in self.report.notes):
                self.report.note("refused", "model", error.joint or error.body or "", str(error))
            error.report = self.report
            if error.path is None and self.file is not None:
                error.path = str(self.file)


def finish(part: Part, source: str, hulls: MeshHulls, choice: MeshChoice) -> Part:
    """Check the model, replace its meshes by hulls or what is chosen, fill the report, and return the part."""
    model, report = part.model, part.report
    check_size(model, source)
    check_joints(model, report, source)
    check_numbers(model, source)
    describe_model(model, report, part.start, part.prefix, part.mimics, part.data.elements)
    part, texts = take_meshes(part, hulls, choice)
    for geometry in part.collision.geometryObjects:
        frame = geometry.parentFrame
        body = part.prefix + model.frames[frame].name if frame else "universe"
        kind = describe(geometry.geometry)
        try:
            done = prepare_geometry(geometry, report, hulls)
        except SceneError as error:
            error.path = error.path or geometry.meshPath or None
            report.geometries.append(GeometryRow(part.prefix + geometry.name, body, kind, "refused"))
            raise
        surface = part.surfaces.get(geometry.name)
        shape = describe(geometry.geometry) if surface is None else surface.kind.capitalize()
        done = "; ".join(filter(None, (done, texts.get(geometry.name))))
        report.geometries.append(GeometryRow(part.prefix + geometry.name, body, shape, done))
    for entry in model.referenceConfigurations:
        part.data.configurations[entry.key()] = np.array(entry.data()), np.zeros(model.nv)
    return part


def neutral(model: pin.Model) -> np.ndarray:
    """Return Pinocchio's neutral configuration moved into the joint limits, shape (nq,)."""
    q = np.asarray(pin.neutral(model))
    for i in range(1, model.njoints):
        if has_limits(model, i):
            k = model.idx_qs[i]
            q[k] = min(max(q[k], model.lowerPositionLimit[k]), model.upperPositionLimit[k])
    return q
