"""Which settings each peer runs on each scene, coarse to fine."""

from __future__ import annotations

from typing import Any

CONTACT = ("S4_e1", "S4_e05", "S5", "S6")
PEERS = ("contactvi", "scipy", "mujoco", "drake", "jiminy", "pybullet")
# Jiminy's damping for e = 0.5 at S4's first impact is 2 zeta sqrt(m_eff k); zeta(0.5) = 0.2552756, m_eff = 1.182926 kg.
JIMINY_HALF = 2.0 * 0.25527564 * 1.18292566**0.5

Settings = list[dict[str, Any]]


def settings(peer: str, scene: str) -> Settings:
    return {
        "contactvi": _contactvi, "scipy": _scipy, "mujoco": _mujoco, "drake": _drake, "jiminy": _jiminy,
        "pybullet": _pybullet,
    }[peer](scene)  # fmt: skip


def _over(key: str, values: list[float], **fixed: Any) -> Settings:
    return [{**fixed, key: value} for value in values]


def _contactvi(scene: str) -> Settings:
    dts = [5e-2, 2e-2, 1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4]
    finer = {"S1": [2e-5, 5e-6, 2e-6], "S3": [5e-5, 2e-5, 1e-5], "S2_n10": [5e-5, 2e-5], "S5": [], "S6": [5e-5, 2e-5]}
    if scene.startswith("S4"):
        finer[scene] = [5e-5, 2e-5, 1e-5]
    maps = ("ctec", "dtec", "mhc") if scene in CONTACT else ("ctec",)  # without impacts the maps are the same
    return [setting for name in maps for setting in _over("dt", dts + finer.get(scene, []), impact=name)]


def _scipy(scene: str) -> Settings:
    return _over("rtol", [10.0**-k for k in range(3, 13)], method="DOP853") + _over(
        "rtol", [1e-4, 1e-6, 1e-8, 1e-10, 1e-12], method="LSODA"
    )


def _mujoco(scene: str) -> Settings:
    if scene in CONTACT:
        dts = [1e-3, 1e-4, 1e-5 if scene.startswith("S4") else 2e-5]
        return [s for i in ("RK4", "Euler") for dt in dts for s in _over("kdt2", [0.01, 0.1], integrator=i, dt=dt)]
    dts = [2e-2, 1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4]
    return _over("dt", dts, integrator="RK4") + _over("dt", [1e-2, 1e-3, 1e-4], integrator="Euler")


def _drake(scene: str) -> Settings:
    if scene in CONTACT:
        pairs = [(1e-5, 1e7), (1e-6, 1e9), (1e-6, 1e11), (1e-7, 1e13), (1e-9, 1e11) if scene == "S6" else (1e-8, 1e15)]
        return [{"integrator": "runge_kutta3", "accuracy": a, "stiffness": k} for a, k in pairs]
    if scene in ("S2_n40", "S2_n100"):
        return _over("accuracy", [1e-2, 1e-4, 1e-6], integrator="runge_kutta3") + _over(
            "accuracy", [1e-4, 1e-6, 1e-8, 1e-10], integrator="runge_kutta5"
        )
    return _over("accuracy", [1e-2, 1e-4, 1e-6], integrator="runge_kutta3") + _over(
        "accuracy", [1e-3, 1e-5, 1e-7, 1e-9, 1e-11, 1e-13], integrator="runge_kutta5"
    )


def _jiminy(scene: str) -> Settings:
    if scene == "S6":
        return []
    if scene in CONTACT:
        pairs = [(1e-6, 1e6), (1e-6, 1e8), (1e-7, 1e10), (1e-8, 1e12), (1e-8, 1e13)]
        damping = JIMINY_HALF if scene == "S4_e05" else 0.0
        return [{"tol": tol, "stiffness": k, "damping": damping * k**0.5} for tol, k in pairs]
    return _over("tol", [10.0**-k for k in range(3, 13)])


def _pybullet(scene: str) -> Settings:
    return _over("dt", [1e-3, 1e-4] if scene not in ("S4_e1", "S4_e05", "S5") else [1e-3, 1e-4, 1e-5])
