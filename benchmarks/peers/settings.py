"""Which settings each peer runs on each scene, coarse to fine."""

from __future__ import annotations

from typing import Any

HANDS = ("inspire_kind", "ability_kind", "svh_kind", "barrett_kind")  # with mimic joints
CONTACT = ("S4_e1", "S4_e05", "S5", "S6")
PEERS = ("contactvi", "contactvi auto", "scipy", "mujoco", "drake", "jiminy", "pybullet")
ESTIMATE = "dop853 estimate"  # of compare.py, derived from scipy's rows
# Jiminy's damping for e = 0.5 at S4's first impact is 2 zeta sqrt(m_eff k); zeta(0.5) = 0.2552756, m_eff = 1.182926 kg.
JIMINY_HALF = 2.0 * 0.25527564 * 1.18292566**0.5

# contactvi: order -> (steps per sample time, tolerances of the stage equations).
HIGH = [1, 2, 3, 4, 5, 6, 8, 10, 12]
PARTS = {
    2: ([10, 50, 200, 1000], [1e-12]),
    4: ([5, 10, 20, 50, 100], [1e-4, 1e-6, 1e-9]),
    8: ([1, 2, 3, 5, 8, 10, 15, 20], [1e-3, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12]),
    12: (HIGH, [1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14]),
    16: (HIGH, [1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14]),
}
LONG = [0.5, 0.2]  # s; steps longer than the sample time, for short calls with contact
DTEC_ORDERS = (2, 8)  # its order is lost across impacts

Settings = list[dict[str, Any]]

# S7, each peer at its usual steps, coarse to fine. contactvi: order 2 throughout, or order 8 in flight. MuJoCo, Drake:
# as they come, and nearer to rigid contact with Coulomb friction (hand_mujoco.py, hand_drake.py: `stiff`).
HAND: dict[str, Settings] = {
    "contactvi": [
        {"order": 2, "dt": 5e-3}, {"order": 2, "dt": 2e-3}, {"order": 2, "dt": 1e-3}, {"order": 2, "dt": 1e-4},
        {"order": 8, "dt": 0.01, "dt_contact": 1e-3},
    ],
    "mujoco": [
        {"integrator": "implicitfast", "dt": 5e-3}, {"integrator": "implicitfast", "dt": 2e-3},
        {"integrator": "Euler", "dt": 1e-3}, {"integrator": "implicitfast", "dt": 1e-3},
        {"integrator": "implicitfast", "dt": 1e-4},
        {"integrator": "implicitfast", "dt": 2e-3, "cone": "elliptic", "stiff": True},
        {"integrator": "implicitfast", "dt": 1e-3, "cone": "elliptic", "stiff": True},
        {"integrator": "implicitfast", "dt": 1e-4, "cone": "elliptic", "stiff": True},
    ],
    "drake": [
        {"approximation": "sap", "dt": 5e-3}, {"approximation": "sap", "dt": 2e-3},
        {"approximation": "sap", "dt": 1e-3}, {"approximation": "lagged", "dt": 1e-3},
        {"approximation": "sap", "dt": 1e-4},
        {"approximation": "sap", "dt": 1e-3, "stiff": True}, {"approximation": "sap", "dt": 1e-4, "stiff": True},
        {"integrator": "cenic", "accuracy": 1e-2}, {"integrator": "cenic", "accuracy": 1e-3},
        {"integrator": "cenic", "accuracy": 1e-4},
    ],
    "pybullet": [{"dt": 1 / 240}, {"dt": 1e-3}, {"dt": 5e-4}, {"dt": 1e-4}],
}  # fmt: skip
HAND_FINE = {"order": 2, "dt": 2e-5}  # contactvi's, not timed: the reference of all others


def settings(peer: str, scene: str) -> Settings:
    if scene == "S7":
        return HAND.get(peer, [])
    return {
        "contactvi": _contactvi, "contactvi auto": _contactvi_auto, "scipy": _scipy, "mujoco": _mujoco,
        "drake": _drake, "jiminy": _jiminy, "pybullet": _pybullet,
    }[peer](scene)  # fmt: skip


def _over(key: str, values: list[float], **fixed: Any) -> Settings:
    return [{**fixed, key: value} for value in values]


def _contactvi(scene: str) -> Settings:
    maps = ("ctec", "mhc", "dtec") if scene in CONTACT else ("ctec",)  # without impacts the maps are the same
    found: Settings = []
    for name in maps:
        for order, (parts, tols) in PARTS.items():
            longer = LONG if scene in CONTACT and order >= 8 else []
            if name == "dtec":
                tols = [1e-12] if order in DTEC_ORDERS else []
            for tol in tols:
                found += _over("dt", longer + [0.1 / k for k in parts], impact=name, order=order, solver_tol=tol)
    return found


def _contactvi_auto(scene: str) -> Settings:
    maps = ("ctec", "mhc") if scene in CONTACT else ("ctec",)
    return [s for name in maps for s in _over("tol", [10.0**-k for k in range(3, 11)], impact=name, dt="auto")]


def _scipy(scene: str) -> Settings:
    if scene in HANDS:
        return [{**s, "equations": name} for name in ("mimic", "projected") for s in _scipy("")]
    return _over("rtol", [10.0**-k for k in range(3, 13)], method="DOP853") + _over(
        "rtol", [1e-4, 1e-6, 1e-8, 1e-10, 1e-12], method="LSODA"
    )


def _mujoco(scene: str) -> Settings:
    if scene in HANDS:  # its joint equalities are soft: the stiffer, the smaller the step
        dts = [5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5]
        return [s for dt in dts for s in _over("kdt2", [0.01, 0.1, 1.0], integrator="RK4", dt=dt)]
    if scene in CONTACT:
        dts = [1e-3, 1e-4, 1e-5 if scene.startswith("S4") else 2e-5]
        return [s for i in ("RK4", "Euler") for dt in dts for s in _over("kdt2", [0.01, 0.1], integrator=i, dt=dt)]
    dts = [2e-2, 1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4]
    return _over("dt", dts, integrator="RK4") + _over("dt", [1e-2, 1e-3, 1e-4], integrator="Euler")


def _drake(scene: str) -> Settings:
    if scene == "talos":  # a free base has to be placed and read in Drake's own numbers
        return []
    if scene in HANDS:
        return _over("dt", [1e-3, 1e-4, 1e-5]) + _over("accuracy", [10.0**-k for k in range(2, 9)], integrator="cenic")
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
    if scene == "S6" or scene in HANDS:
        return []
    if scene in CONTACT:
        pairs = [(1e-6, 1e6), (1e-6, 1e8), (1e-7, 1e10), (1e-8, 1e12), (1e-8, 1e13)]
        damping = JIMINY_HALF if scene == "S4_e05" else 0.0
        return [{"tol": tol, "stiffness": k, "damping": damping * k**0.5} for tol, k in pairs]
    return _over("tol", [10.0**-k for k in range(3, 13)])


def _pybullet(scene: str) -> Settings:
    if scene == "talos" or scene in HANDS:  # Talos: its base stands at the centre of mass
        return []
    return _over("dt", [1e-3, 1e-4] if scene not in ("S4_e1", "S4_e05", "S5") else [1e-3, 1e-4, 1e-5])
