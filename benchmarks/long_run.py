"""Energy of the double pendulum at a wall over 1e4 s (7000 impacts), against cost: contactvi's orders against scipy.

    python benchmarks/long_run.py [--duration 1e4] [--orders 2,4,8,12,16] [-o DIR]

Problem B, models/double_pendulum_wall.toml, e = 1, dH = H - H(0) every 0.1 s. Each run is kept in DIR/rows.json as soon
as it is done and is not repeated. Drift: mean of dH over the last tenth of the run less that over the first tenth.
scipy is solve_ivp (DOP853, atol = rtol / 10) on pin.aba with the tip's place as event function and the exact
reflection: what one writes without a package. `compiled` is no program but an estimate: scipy's evaluations at the time
of contactvi's own scalar evaluation, and no other cost. Equal cost: the most accurate rival that costs at most
1.25 times as much; where every rival costs more, the cheapest one, marked `>`.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp

import contactvi as cvi
from models import evaluation_seconds

SCENE = Path(__file__).resolve().parents[1] / "models" / "double_pendulum_wall.toml"
SAMPLE = 0.1  # [s]
WINDOW = 200  # samples of one call of solve_ivp
STEPS = {  # order -> dt [s]
    2: [0.02, 0.01, 0.005, 0.002],
    4: [0.05, 0.02, 0.01, 0.005],
    8: [0.1, 0.05, 0.1 / 3, 0.02],
    12: [0.2, 0.1, 0.05, 0.1 / 3],
    16: [0.2, 0.1, 0.05, 0.1 / 3],
}
RTOLS = [1e-3, 1e-5, 1e-7, 1e-9, 1e-11, 1e-13]
RIVALS = {"scipy": "#000000", "compiled": "#888888"}
Row = dict[str, Any]


def jobs(orders: list[int], maps: list[str]) -> list[Row]:
    own = [
        {"code": "contactvi", "order": order, "impact": name, "dt": dt, "solver_tol": 1e-12 if order < 8 else 1e-15}
        for order in orders
        for name in maps
        for dt in STEPS[order]
    ]
    return own + [{"code": "scipy", "rtol": rtol} for rtol in RTOLS]


def run_contactvi(scene: cvi.Scene, job: Row, duration: float) -> tuple[float, np.ndarray, Row]:
    """Wall time [s], energies at the samples and counts."""
    ratio = SAMPLE / job["dt"]
    sampled = {"record_every": round(ratio)} if ratio > 0.99 else {"sample_dt": SAMPLE}
    dt = SAMPLE / round(ratio) if ratio > 0.99 else job["dt"]
    chosen = {name: job[name] for name in ("order", "impact", "solver_tol")}
    began = time.perf_counter()
    traj = cvi.simulate(scene, duration=duration, dt=dt, **chosen, **sampled)
    return time.perf_counter() - began, np.array(traj.energy), {"impacts": len(traj.events)}


def run_scipy(scene: cvi.Scene, job: Row, duration: float) -> tuple[float, np.ndarray, Row]:
    """Wall time [s], energies and counts of solve_ivp: state (q, v), an event where the tip meets the wall x = 0."""
    model, data, tau = scene.model, scene.model.createData(), np.zeros(2)
    samples = np.arange(1, round(duration / SAMPLE) + 1) * SAMPLE
    options = {"method": "DOP853", "rtol": job["rtol"], "atol": 0.1 * job["rtol"]}

    def rate(_: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[2:], pin.aba(model, data, y[:2], y[2:], tau)])

    def tip(_: float, y: np.ndarray) -> float:
        return float(np.sin(y[0]) + np.sin(y[0] + y[1]))

    tip.terminal, tip.direction = True, -1.0  # type: ignore[attr-defined]
    y, t, done, parts = np.concatenate([scene.q0, np.zeros(2)]), 0.0, 0, []
    counts = {"impacts": 0, "evaluations": 0}
    began = time.perf_counter()
    while done < len(samples):
        asked = samples[done : done + WINDOW]
        out = solve_ivp(rate, (t, asked[-1]), y, t_eval=asked, events=tip, **options)
        counts["evaluations"] += out.nfev
        if len(out.t):
            parts.append(out.y.T)
            done += len(out.t)
        if out.status == 1:
            t, y = out.t_events[0][0], reflect(model, out.y_events[0][0])
            counts["impacts"] += 1
        else:
            t, y = out.t[-1], out.y[:, -1]
    seconds = time.perf_counter() - began
    states = np.concatenate([[np.concatenate([scene.q0, np.zeros(2)])], *parts])
    return seconds, np.array([energy(model, data, s) for s in states]), counts


def reflect(model: pin.Model, y: np.ndarray) -> np.ndarray:
    q, v = y[:2], y[2:]
    row = np.array([np.cos(q[0]) + np.cos(q[0] + q[1]), np.cos(q[0] + q[1])])
    mass = pin.crba(model, model.createData(), q)
    change = np.linalg.solve(np.triu(mass) + np.triu(mass, 1).T, row)
    return np.concatenate([q, v - 2.0 * (row @ v) / (row @ change) * change])


def energy(model: pin.Model, data: pin.Data, y: np.ndarray) -> float:
    return pin.computeKineticEnergy(model, data, y[:2], y[2:]) + pin.computePotentialEnergy(model, data, y[:2])


def judge(job: Row, seconds: float, energies: np.ndarray, counts: Row, duration: float) -> Row:
    error = energies - energies[0]
    tenths = np.array_split(error, 10)
    return {
        **job, **counts, "duration": duration, "ms_per_s": 1e3 * seconds / duration,
        "max": float(np.abs(error).max()), "drift": float(tenths[-1].mean() - tenths[0].mean()),
        "growth": [float(np.abs(part).max()) for part in np.array_split(error, 50)],
    }  # fmt: skip


def label(row: Row) -> str:
    if row["code"] == "contactvi":
        return f"order {row['order']}, {row['impact']}, dt {row['dt']:.3g}"
    return f"{row['code']}, rtol {row['rtol']:.0e}"


def equal_cost(row: Row, rivals: list[Row]) -> str:
    affordable = [r for r in rivals if r["ms_per_s"] <= 1.25 * row["ms_per_s"]]
    if affordable:
        found, mark = min(affordable, key=lambda r: r["max"]), ""
    else:
        found, mark = min(rivals, key=lambda r: r["ms_per_s"]), "> "
    return f"{mark}{found['ms_per_s']:.3g} (rtol {found['rtol']:.0e}) | {found['max']:.1e} | {found['drift']:.1e}"


def table(rows: list[Row]) -> str:
    own = [row for row in rows if row["code"] == "contactvi"]
    rivals = {code: [row for row in rows if row["code"] == code] for code in ("scipy", "compiled")}
    rivals = {code: group for code, group in rivals.items() if group}
    head = ["order", "map", "dt", "impacts", "ms/s", "max dH [J]", "drift [J]"]
    for code in rivals:
        head += [f"{code} at equal cost: ms/s", "max dH", "drift"]
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for row in own:
        cells = [f"{row['order']} | {row['impact']} | {row['dt']:.3g} | {row['impacts']} | {row['ms_per_s']:.3g}"]
        cells += [f"{row['max']:.1e} | {row['drift']:.1e}"] + [equal_cost(row, group) for group in rivals.values()]
        lines.append("| " + " | ".join(cells) + " |")
    lines += ["", "| rival | impacts | ms/s | max dH [J] | drift [J] |", "|---|---|---|---|---|"]
    for row in [row for group in rivals.values() for row in group]:
        lines.append(
            f"| {label(row)} | {row['impacts']} | {row['ms_per_s']:.3g} | {row['max']:.1e} | {row['drift']:.1e} |"
        )
    return "\n".join(lines) + "\n"


def picture(rows: list[Row], path: Path) -> None:
    """Left: largest energy error over cost. Right: its growth in time, each method's run nearest to the same cost."""
    figure = Figure(figsize=(11, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(f"order {row['order']} {row['impact']}" if "order" in row else row["code"], []).append(row)
    for k, (name, group) in enumerate(groups.items()):
        color = RIVALS.get(name, f"C{k // 2}")  # one color per order, one line style per map
        style = {"color": color, "ls": "--" if "mhc" in name else "-", "label": name}
        group = sorted(group, key=lambda r: r["ms_per_s"])
        left.loglog([r["ms_per_s"] for r in group], [max(r["max"], 1e-16) for r in group], "o", ms=4, **style)
        if name != "compiled":
            middle = group[len(group) // 2]
            times = middle["duration"] * (np.arange(50) + 0.5) / 50
            right.semilogy(times, np.maximum(middle["growth"], 1e-16), **{**style, "label": label(middle)})
    left.set(xlabel="ms per simulated s", ylabel="largest |H - H(0)| [J]")
    right.set(xlabel="t [s]", ylabel="|H - H(0)| [J]")
    for panel in (left, right):
        panel.grid(alpha=0.25)
        panel.legend(fontsize=6)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--duration", type=float, default=1e4)
    parser.add_argument("--orders", default=",".join(map(str, STEPS)))
    parser.add_argument("--maps", default="ctec,mhc")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/long_run"))
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    file = args.output / "rows.json"
    rows: list[Row] = json.loads(file.read_text()) if file.exists() else []
    scene = cvi.load_scene(SCENE)
    cvi.simulate(scene, duration=1.0, dt=0.01)  # warm-up
    wanted = jobs([int(order) for order in args.orders.split(",")], args.maps.split(","))
    for job in wanted:
        if any({**job, "duration": args.duration}.items() <= row.items() for row in rows):
            continue
        run = run_contactvi if job["code"] == "contactvi" else run_scipy
        try:
            rows.append(judge(job, *run(scene, job, args.duration), args.duration))
        except cvi.ContactviError as error:
            print(f"{label(job)} failed: {error}", flush=True)
            continue
        print(f"{label(rows[-1])}: {rows[-1]['ms_per_s']:.3g} ms/s, {rows[-1]['max']:.1e} J", flush=True)
        file.write_text(json.dumps(rows))
    rows = [row for row in rows if row["duration"] == args.duration]
    seconds = evaluation_seconds(scene, scene.q0, np.zeros(2))
    for row in [row for row in rows if row["code"] == "scipy"]:
        cost = 1e3 * seconds * row["evaluations"] / row["duration"]
        rows.append({**row, "code": "compiled", "ms_per_s": cost})
    text = f"{time.strftime('%Y-%m-%d')}, {args.duration:g} s.\n\n{table(rows)}"
    (args.output / "long_run.md").write_text(text)
    picture(rows, args.output / "long_run.png")
    print(text)


if __name__ == "__main__":
    main()
