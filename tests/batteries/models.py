"""The battery: named models with random states, built with pin alone."""

from __future__ import annotations

import importlib.metadata
import pathlib
import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin


def unit(*x: float) -> np.ndarray:
    """Unit vector along x."""
    return np.array(x) / np.linalg.norm(x)


def continuous_unaligned(axis: np.ndarray) -> pin.JointModel:
    """Continuous joint about any axis; pin's Python constructor takes no axis, so it comes from a URDF."""
    x, y, z = (repr(float(a)) for a in axis)
    urdf = (
        '<robot name="r"><link name="a"/><link name="b"><inertial><mass value="1"/>'
        '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>'
        '<joint name="j" type="continuous"><parent link="a"/><child link="b"/>'
        f'<axis xyz="{x} {y} {z}"/></joint></robot>'
    )
    return pin.buildModelFromXML(urdf).joints[1]


SKEW = unit(1.0, -2.0, 0.5)
JOINTS: dict[str, Callable[[], pin.JointModel]] = {
    "revolute_x": pin.JointModelRX,
    "revolute_y": pin.JointModelRY,
    "revolute_z": pin.JointModelRZ,
    "revolute_unaligned": lambda: pin.JointModelRevoluteUnaligned(SKEW),
    "continuous_x": pin.JointModelRUBX,
    "continuous_y": pin.JointModelRUBY,
    "continuous_z": pin.JointModelRUBZ,
    "continuous_unaligned": lambda: continuous_unaligned(SKEW),
    "prismatic_x": pin.JointModelPX,
    "prismatic_y": pin.JointModelPY,
    "prismatic_z": pin.JointModelPZ,
    "prismatic_unaligned": lambda: pin.JointModelPrismaticUnaligned(SKEW),
    "helical_x": lambda: pin.JointModelHX(0.3),
    "helical_y": lambda: pin.JointModelHY(-0.2),
    "helical_z": lambda: pin.JointModelHZ(0.1),
    "helical_unaligned": lambda: pin.JointModelHelicalUnaligned(SKEW, 0.15),
    "planar": pin.JointModelPlanar,
    "translation": pin.JointModelTranslation,
    "spherical": pin.JointModelSpherical,
    "free_flyer": pin.JointModelFreeFlyer,
}


class Builder:
    """Adds joints with random placements and random bodies to a model."""

    def __init__(self, seed: int):
        self.rng, self.model = np.random.default_rng(seed), pin.Model()

    def placement(self, size: float = 0.4) -> pin.SE3:
        return pin.SE3(pin.exp3(self.rng.uniform(-1, 1, 3)), self.rng.uniform(-size, size, 3))

    def inertia(self) -> pin.Inertia:
        """Positive definite about the centre of mass, with the triangle inequality strict."""
        mass, spread = self.rng.uniform(0.5, 2.0), self.rng.uniform(0.1, 0.3, 3) ** 2
        moments = mass * (spread.sum() - spread)
        r = pin.exp3(self.rng.uniform(-2, 2, 3))
        return pin.Inertia(mass, self.rng.uniform(-0.2, 0.2, 3), r @ np.diag(moments) @ r.T)

    def add(self, kind: str, parent: int = 0, placement: pin.SE3 | None = None) -> int:
        m = self.model
        joint = m.addJoint(parent, JOINTS[kind](), placement or self.placement(), f"{kind}{m.njoints}")
        m.addJointFrame(joint)
        m.appendBodyToJoint(joint, self.inertia(), pin.SE3.Identity())
        return joint

    def chain(self, *kinds: str, parent: int = 0) -> int:
        for kind in kinds:
            parent = self.add(kind, parent)
        return parent


def robots() -> pathlib.Path:
    """Folder of the robots of example-robot-data, wherever it is installed."""
    files = importlib.metadata.distribution("example-robot-data").files or []
    found = next(f for f in files if str(f).endswith("share/example-robot-data/package.xml"))
    return pathlib.Path(str(found.locate())).resolve().parent / "robots"


def _single(kind: str) -> pin.Model:
    b = Builder(zlib.crc32(kind.encode()))
    b.chain("revolute_unaligned", kind, "revolute_x")
    return b.model


def _free_body() -> pin.Model:
    b = Builder(1)
    b.add("free_flyer", placement=pin.SE3.Identity())
    return b.model


def _arm() -> pin.Model:
    b = Builder(2)
    b.chain("revolute_z", "spherical", "revolute_x", "revolute_unaligned")
    b.model.armature = np.array([0.1, 0.0, 0.0, 0.0, 0.05, 0.02])
    return b.model


def double_pendulum() -> pin.Model:
    """Two point masses 1 kg on rods of 1 m in the x-z plane, hanging; relative joint angles."""
    m = pin.Model()
    for i in range(2):
        placement = pin.SE3(np.eye(3), np.array([0.0, 0.0, -1.0 if i else 0.0]))
        j = m.addJoint(i, pin.JointModelRevoluteUnaligned(np.array([0.0, -1.0, 0.0])), placement, f"joint{i + 1}")
        m.appendBodyToJoint(j, pin.Inertia(1.0, np.array([0.0, 0.0, -1.0]), np.zeros((3, 3))), pin.SE3.Identity())
    return m


def _urdf(path: str, free: bool) -> pin.Model:
    root = (pin.JointModelFreeFlyer(),) if free else ()
    return pin.buildModelFromUrdf(str(robots() / path), *root)


def _tree() -> pin.Model:
    b = Builder(3)
    root = b.add("free_flyer")
    left = b.chain("revolute_unaligned", "continuous_unaligned", parent=root)
    b.chain("helical_unaligned", "revolute_y", parent=left)
    b.chain("prismatic_unaligned", "spherical", parent=left)
    b.chain("revolute_unaligned", "revolute_unaligned", parent=root)
    return b.model


def _forest() -> pin.Model:
    b = Builder(4)
    b.chain("free_flyer", "revolute_x")
    b.chain("revolute_unaligned", "revolute_y")
    b.add("free_flyer")
    b.chain("planar", "revolute_z")
    b.add("prismatic_x")
    b.chain("translation", "spherical")
    return b.model


def _pair() -> pin.Model:
    b = Builder(5)
    b.chain("free_flyer", "spherical")
    b.chain("free_flyer", "continuous_z", "prismatic_y")
    return b.model


@dataclass(frozen=True)
class Case:
    """One model: `speed` scales the random velocities [rad/s, m/s], `h` is a sensible time step [s]."""

    name: str
    build: Callable[[], pin.Model]
    speed: float = 1.0
    h: float = 1e-2

    def model(self) -> pin.Model:
        """The model without limits, damping and friction, so that only the law under test acts."""
        m = self.build()
        m.lowerPositionLimit, m.upperPositionLimit = np.full(m.nq, -np.inf), np.full(m.nq, np.inf)
        m.damping = np.zeros(m.nv)
        m.lowerDryFrictionLimit, m.upperDryFrictionLimit = np.zeros(m.nv), np.zeros(m.nv)
        return m

    def state(self, model: pin.Model, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Random (q, v) in Pinocchio coordinates."""
        rng = np.random.default_rng([zlib.crc32(self.name.encode()), seed])
        q = pin.integrate(model, pin.neutral(model), rng.uniform(-0.8, 0.8, model.nv))
        return q, self.speed * rng.uniform(-1, 1, model.nv)


CASES = [Case(f"joint_{kind}", lambda kind=kind: _single(kind)) for kind in JOINTS] + [  # type: ignore[misc]
    Case("free_body", _free_body, 3.0),
    Case("arm_spherical", _arm),
    Case("double_pendulum", double_pendulum),
    Case("allegro", lambda: _urdf("allegro_hand_description/urdf/allegro_right_hand.urdf", False), 1.0, 2e-3),
    Case("talos", lambda: _urdf("talos_data/robots/talos_full_v2.urdf", True), 1.0, 2e-3),
    Case("tree", _tree),
    Case("forest", _forest),
    Case("pair", _pair),
]
FREE_FLOATING = [c for c in CASES if c.name in ("free_body", "talos", "tree", "pair")]
SMALL = [c for c in CASES if c.name not in ("allegro", "talos")]


def case(name: str) -> Case:
    """The case called `name`."""
    return next(c for c in CASES if c.name == name)


def springs_of(model: pin.Model, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Random springs on 1-dof, spherical and translation joints, damping equal within a joint's parts."""
    k, d = np.zeros(model.njoints), np.zeros(model.nv)
    for i in range(1, model.njoints):
        j = model.joints[i]
        if j.shortname() not in ("JointModelFreeFlyer", "JointModelPlanar"):
            k[i] = rng.uniform(1, 5)
        d[j.idx_v : j.idx_v + j.nv] = rng.uniform(0.1, 0.5)
    rest = pin.integrate(model, pin.neutral(model), rng.uniform(-0.3, 0.3, model.nv))
    return {"stiffness": k, "rest": rest, "damping": d}
