"""contactvi: accurate rigid contact for URDF and MJCF models with variational integrators.

    import contactvi as cvi

    scene = cvi.load_scene("models/allegro_ball.toml")
    traj = cvi.simulate(scene)
    traj.save("run.npz")
    cvi.view(traj)

Every public name is loaded on first use, so that `import contactvi` stays quick and needs neither meshcat nor
matplotlib.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from contactvi import errors
    from contactvi.contacts import ChangeLog, Contact, ContactChange, ContactLog
    from contactvi.dense import State
    from contactvi.derivative_check import check_derivatives
    from contactvi.errors import (
        AccuracyWarning,
        ConstraintError,
        ContactviError,
        DerivativeError,
        InputError,
        PenetrationError,
        SceneError,
        SimulationError,
        UnsupportedJointError,
        UserFunctionError,
    )
    from contactvi.events import Event, EventLog
    from contactvi.options import Options
    from contactvi.plots import plot, plot_forces
    from contactvi.scene import Scene
    from contactvi.scene_file import load_scene
    from contactvi.sensors import ContactSensor, Imu, JointEncoder
    from contactvi.simulation import simulate
    from contactvi.simulator import Simulator
    from contactvi.simultaneous import SimultaneousOutcomes, simultaneous_outcomes
    from contactvi.status import Stats, Status, StatusCode
    from contactvi.trajectory import Trajectory
    from contactvi.viewer import view

    __version__: str

_HOME = {
    "AccuracyWarning": "errors",
    "ConstraintError": "errors",
    "ContactviError": "errors",
    "DerivativeError": "errors",
    "InputError": "errors",
    "PenetrationError": "errors",
    "SceneError": "errors",
    "SimulationError": "errors",
    "UnsupportedJointError": "errors",
    "UserFunctionError": "errors",
    "check_derivatives": "derivative_check",
    "ChangeLog": "contacts",
    "Contact": "contacts",
    "ContactChange": "contacts",
    "ContactLog": "contacts",
    "Event": "events",
    "EventLog": "events",
    "Options": "options",
    "Scene": "scene",
    "load_scene": "scene_file",
    "ContactSensor": "sensors",
    "Imu": "sensors",
    "JointEncoder": "sensors",
    "simulate": "simulation",  # not "simulate": a submodule of that name would shadow the function
    "Simulator": "simulator",
    "SimultaneousOutcomes": "simultaneous",
    "simultaneous_outcomes": "simultaneous",
    "State": "dense",
    "Stats": "status",
    "Status": "status",
    "StatusCode": "status",
    "Trajectory": "trajectory",
    "view": "viewer",
    "plot": "plots",
    "plot_forces": "plots",
}

__all__ = [
    "AccuracyWarning",
    "ChangeLog",
    "ConstraintError",
    "Contact",
    "ContactChange",
    "ContactLog",
    "ContactSensor",
    "ContactviError",
    "DerivativeError",
    "Event",
    "EventLog",
    "Imu",
    "InputError",
    "JointEncoder",
    "Options",
    "PenetrationError",
    "Scene",
    "SceneError",
    "SimulationError",
    "Simulator",
    "SimultaneousOutcomes",
    "State",
    "Stats",
    "Status",
    "StatusCode",
    "Trajectory",
    "UnsupportedJointError",
    "UserFunctionError",
    "__version__",
    "check_derivatives",
    "errors",
    "load_scene",
    "plot",
    "plot_forces",
    "simulate",
    "simultaneous_outcomes",
    "view",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from contactvi.version import version

        value: Any = version()
    elif name == "errors":
        value = importlib.import_module("contactvi.errors")
    elif name in _HOME:
        value = getattr(importlib.import_module(f"contactvi.{_HOME[name]}"), name)
    else:
        raise AttributeError(f"module 'contactvi' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(set(globals()) | set(__all__))
