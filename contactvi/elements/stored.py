"""Elements of a scene from plain data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from contactvi.elements.constraints import (
    DistanceConstraint,
    EqualityConstraint,
    PointConstraint,
    PrescribedJoint,
    PrescribedPose,
    ScrewConstraint,
    WeldConstraint,
)
from contactvi.elements.element import Element
from contactvi.elements.forces import PathSpring, Wrench

KINDS: dict[str, type[Element]] = {
    cls.kind: cls
    for cls in (
        *(PointConstraint, DistanceConstraint, WeldConstraint, ScrewConstraint, EqualityConstraint),
        *(PrescribedJoint, PrescribedPose),
        *(PathSpring, Wrench),
    )
}


def element_from_data(data: Mapping[str, Any]) -> Element:
    """Return the element of `Element.to_data`."""
    values = dict(data)
    cls = KINDS[values.pop("kind")]
    for name in ("placement", "frame_a", "frame_b"):
        if values.get(name) is not None:
            values[name] = np.array(values[name], dtype=float).reshape(4, 4)
    return cls(**values)
