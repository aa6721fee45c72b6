"""The compiled engine as the tests use it, below the Python API: contactvi._core with arrays only."""

from __future__ import annotations

import numpy as np
import pinocchio as pin


def scene_of_shapes(model: pin.Model, shapes: pin.GeometryModel, stiffness=None, rest=None, damping=None, limits=0.0):
    """Engine scene of a model and all collision pairs of its shapes; impacts are elastic, without friction."""
    from contactvi import _core
    from contactvi.importing.engine_model import engine_model
    from contactvi.scene.engine import shapes_by_address

    n = model.njoints
    pairs = np.array([(pair.first, pair.second) for pair in shapes.collisionPairs], dtype=np.int32).reshape(-1, 2)
    return _core.Scene(
        engine_model(model),
        shapes_by_address(shapes),
        pairs,
        np.ones(len(pairs)),
        np.zeros(len(pairs)),
        np.zeros(n) if stiffness is None else np.asarray(stiffness, float),
        pin.neutral(model) if rest is None else np.asarray(rest, float),
        np.zeros(model.nv) if damping is None else np.asarray(damping, float),
        np.full(n, limits),
        np.ones(n),
    )


def core_scene(model: pin.Model, stiffness=None, rest=None, damping=None):
    """Engine scene of a model without geometry and limits; springs and damping as in oracles.del_step.System."""
    return scene_of_shapes(model, pin.GeometryModel(), stiffness, rest, damping)


def simulator(scene, dt: float, **options):
    """The engine's simulator with steps dt [s] and fields of _core.SimulatorOptions."""
    from contactvi import _core

    settings = _core.SimulatorOptions()
    for name, value in {"dt": dt, **options}.items():
        setattr(settings, name, value)
    return _core.Simulator(scene, settings)


def stepper(scene, h: float, tau=None, tol: float = 1e-13, order: int = 2):
    """(q0, p0) -> (q1, p1) of the engine's smooth step, in the signature of tests/helpers/laws.py."""

    def step(q, p):
        q1, p1, *_ = scene.step(q, p, h, tau, tol, order)
        return q1, p1

    return step


def advance(scene, model: pin.Model, q, v, h: float, steps: int, every: int = 1, tau=None, tol=1e-13, order: int = 2):
    """Nodes (t, q, p) of a run through the event loop; fails unless the status is SUCCESS."""
    run = simulator(scene, h, tol=tol, order=order)
    start = run.reset(q, v, 0.0)
    assert start["code"] == 0, start["message"]
    forces = None if tau is None else np.tile(tau, (steps, 1))
    result = run.advance(steps, forces, every, None)
    assert result["code"] == 0, result["message"]
    return result["t"], result["q"], result["p"]


def contacts_of(result, scene):
    """Columns of the contacts in a result of this cvi.Scene, those of what lies still among them."""
    from contactvi.records.still import Span, WithStill

    spans = [Span(rows.columns(scene.core()), *span) for rows, *span in result["still"] or ()]
    return WithStill(result["contacts"], spans) if spans else result["contacts"]
