"""The command line of the scripts that look for faults: many recipes, each run in a process of its own with a limit."""

from __future__ import annotations

import argparse
import json
import multiprocessing
import resource
import signal
import time
import traceback
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import checks
import numpy as np
from recipes import Recipe

import contactvi as cvi

Make = Callable[[str, int], Recipe]
MEMORY = 6 << 30  # [bytes] of address space of a run
GRACE = 5.0  # [s] from the interrupt, after which a run still returns what it has, to the end of its process
WORST_FIRST = ("crash", "wrong", "told", "ledger", "time", "reported", "refused", "slow", "ok")


# --- one run ----------------------------------------------------------------------------------------------------------
def guarded(recipe: Recipe, limit: float) -> dict[str, Any]:
    """Return what `checks.measure` finds in a forked process that is interrupted after `limit` [s]."""
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=_work, args=(recipe, sender, limit))
    child.start()
    sender.close()
    known = {"family": recipe.family, "seed": recipe.seed, "kinds": checks.kinds(recipe), "faults": [],
             "e": recipe.restitution, "mu": recipe.friction}  # fmt: skip
    try:
        if receiver.poll(2 * limit + 3 * GRACE):
            return known | receiver.recv()
        child.kill()
        return known | {"class": "time", "faults": [f"not back after {2 * limit:.0f} s, and does not stop"]}
    except EOFError:
        child.join()
        return known | {"class": "crash", "faults": [f"exit code {child.exitcode}"]}
    finally:
        child.join(GRACE)
        if child.is_alive():
            child.kill()


def _work(recipe: Recipe, sender: Any, limit: float) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(signal.SIGINT))
    signal.setitimer(signal.ITIMER_REAL, limit)
    try:
        sender.send(checks.measure(recipe))
    except KeyboardInterrupt:
        sender.send({"class": "time", "faults": [f"not ready after {limit:.0f} s"]})
    except Exception:
        sender.send({"class": "crash", "faults": [traceback.format_exc()[-1500:]]})


# --- tables -----------------------------------------------------------------------------------------------------------
def line(found: dict[str, Any]) -> str:
    """Return a run in one line."""
    head = f"{found['class']:8} {found['family']}:{found['seed']:<5} e={found['e']} mu={found['mu']}"
    if "gap" in found:
        head += f" gap {found['gap']:8.1e} dE {max(found['energy'], found['over_run']):7.1e}"
        head += f" x{found.get('ratio', float('nan')):6.1f} dense {found['dense']:5} hits {found['impacts']:5}"
    return f"{head} | {found['kinds']} | {'; '.join(found['faults'])} {found.get('message', '')}".rstrip()


def summary(runs: Iterable[dict[str, Any]]) -> str:
    """Return for each family the counts of the classes, and median and worst of gap, energy and time."""
    groups: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for found in runs:
        groups[found["family"]].append(found)
        groups["all"].append(found)
    groups["all"] = groups.pop("all", [])
    head = "runs  least gap (median, worst)   energy (median, worst)   time over MuJoCo    classes, statuses"
    lines = [f"{'family':14} {head}"]
    for family, members in groups.items():
        gaps, energies, ratios = (
            np.array([f(found) for found in members if "gap" in found] or [np.nan])
            for f in (
                lambda x: x["gap"], lambda x: max(x["energy"], x["over_run"]), lambda x: x.get("ratio", np.nan),
            )
        )  # fmt: skip
        classes = Counter(found["class"] for found in members)
        statuses = Counter(found["status"] for found in members if found.get("status", "SUCCESS") != "SUCCESS")
        counts = ", ".join(f"{kind} {classes[kind]}" for kind in WORST_FIRST if classes[kind])
        slow = sum(found.get("ratio", 0.0) > checks.SLOW for found in members)
        lines.append(
            f"{family:14} {len(members):4}  {np.median(gaps):10.1e} {np.min(gaps):10.1e}    {np.median(energies):10.1e}"
            f" {np.max(energies):10.1e}   {np.median(ratios):7.1f} {np.max(ratios):7.1f}    {counts}"
            + (f"; over {checks.SLOW:.0f} times MuJoCo's time {slow}" if slow else "")
            + (f"; {dict(statuses)}" if statuses else "")
        )
    return "\n".join(lines)


# --- one scene --------------------------------------------------------------------------------------------------------
def show(recipe: Recipe) -> None:
    """Print everything about a run, and its worst nodes."""
    print(recipe.script())
    found = checks.measure(recipe)
    for key, value in found.items():
        print(f"{key:18} {value}")
    if "gap" not in found:
        return
    scene, q0, v0 = recipe.build()
    traj, *_ = checks.run(scene, q0, v0, recipe.duration)
    print(traj.stepping)
    times = {"gap": found["deep_time"], "energy": found["energy_time"], "closed form": found["free_time"]}
    for what, t in times.items():
        if t is not None:
            print(f"\n--- around the worst {what}, {t:.4f} s")
            around(scene, traj, t, found["largest"])


def around(scene: cvi.Scene, traj: cvi.Trajectory, t: float, size: float, nodes: int = 3) -> None:
    """Print the nodes, contacts, events and changes about a time."""
    middle = int(np.searchsorted(traj.t, t - 1e-12))
    energy, names = traj.energy, scene.gap_names
    for k in range(max(0, middle - nodes), min(len(traj.t), middle + nodes + 1)):
        gaps = scene.gaps(traj.q[k])
        near = ", ".join(f"{'-'.join(names[i])} {gaps[i]:.1e}" for i in np.argsort(gaps)[:6] if gaps[i] < 1e-2)
        change = (energy[k] - energy[max(k - 1, 0)]) / size
        print(f"t = {traj.t[k]:.4f} energy changed by {change:9.1e} | {near}")
    low, high = traj.t[max(0, middle - nodes)] - 1e-9, traj.t[min(len(traj.t) - 1, middle + nodes)] + 1e-9
    rows = traj.contacts
    for k in np.flatnonzero((rows.t >= low) & (rows.t <= high))[:60]:
        row = rows[int(k)]
        print(
            f"  {row.t:.6f} +{row.h:.1e} {'-'.join(row.pair)} point {row.point} feature {rows.array('feature')[k]}"
            f" {row.mode}{' dense' if row.dense else ''} n {np.round(row.normal, 4)}"
            f" impulse {row.impulse @ row.normal:.3e} gap {row.gap:.1e} slip {np.linalg.norm(row.slip):.1e}"
        )
    for event in traj.events:
        if low <= event.time <= high:
            print(
                f"  impact {event.time:.9f} {'-'.join(event.pair)} speeds {event.gamma_minus:.2e}"
                f" {event.gamma_plus:.2e} points {event.points} loss {event.loss:.1e} gap {event.gap:.1e}"
            )
    for change in traj.contact_changes:
        if low <= change.time <= high:
            print(f"  {change.change} {change.time:.9f} {'-'.join(change.pair)} point {change.point}")


def _word(fault: str) -> str:
    """The kind of a fault: its first word, "slow" of a long time."""
    return "slow" if "MuJoCo" in fault else fault.split()[0]


MEASURE = {"gap": "gap", "distances": "difference", "energy": "energy", "over_run": "over_run", "slow": "ratio",
           "friction_loss": "friction_loss", "impact_loss": "impact_loss", "losses": "balance",
           "residual": "residual"}  # fmt: skip


def reduced(recipe: Recipe, limit: float, fault: str = "") -> Recipe:
    """Return a recipe of fewer items and simpler numbers with the same fault, by default the first of the run."""

    def severity(other: Recipe) -> dict[str, float]:
        found = guarded(other, limit)
        if found.get("status") == "PENETRATION":
            return {}
        words = [_word(fault) for fault in found["faults"]] or [found["class"]]
        return {word: abs(found.get(MEASURE.get(word, ""), 1.0)) for word in words}

    def same(other: Recipe) -> bool:
        """Whether it has the first fault of the first recipe, to a third of it."""
        try:
            return severity(other).get(worst, -1.0) > first[worst] / 3.0
        except cvi.ContactviError:
            return False

    first = severity(recipe)
    worst = fault or next(iter(first), "")
    if worst not in first:
        raise SystemExit(f"The run has no such fault, but {', '.join(first)}")
    for item in recipe.items:
        smaller = recipe.less({item.name})
        if smaller.items and same(smaller):
            recipe = smaller
    changes: list[Callable[[Recipe], Recipe]] = [
        lambda r: replace(r, friction=0.0), lambda r: replace(r, restitution=0.0),
        lambda r: replace(r, items=tuple(replace(i, velocity=(0.0,) * 3, spin=(0.0,) * 3) for i in r.items)),
        lambda r: replace(r, items=tuple(replace(i, mass=1.0) for i in r.items)),
    ]  # fmt: skip
    for digits in (2, 3, 5):
        changes.append(lambda r, n=digits: replace(r, items=tuple(_rounded(i, n) for i in r.items)))
    for change in changes:
        simpler = change(recipe)
        if simpler != recipe and same(simpler):
            recipe = simpler
    return recipe


def _rounded(item: Any, digits: int) -> Any:
    values = {
        name: tuple(round(x, digits) for x in getattr(item, name)) for name in ("place", "turn", "velocity", "spin")
    }
    size = item.size if item.shape in ("mesh", "urdf", "halfspace") else np.round(item.size, digits + 1).tolist()
    return replace(item, size=size, mass=round(item.mass, digits), **values)


# --- command line -----------------------------------------------------------------------------------------------------
def main(doc: str | None, families: Iterable[str], make: Make, seeds: int) -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default=f"0:{seeds}", help="A:B, or one seed, of every family")
    parser.add_argument("--families", default=",".join(families), help="separated by commas, or parts of their names")
    parser.add_argument("--json", type=Path, help="write what is known of every run to this file, a line each")
    parser.add_argument("--limit", type=float, default=60.0, help="of a run [s]")
    parser.add_argument("--show", type=int, metavar="SEED", help="everything about one scene of the first family")
    parser.add_argument("--reduce", type=int, metavar="SEED", help="a smaller scene with the same fault, as a script")
    parser.add_argument("--fault", default="", help="that --reduce keeps: gap, energy, losses, residual, slow, ...")
    args = parser.parse_args()
    known = list(families)
    wanted = [name for name in known if any(part in name for part in args.families.split(","))]
    exact = [name for name in args.families.split(",") if name in known]
    if args.show is not None or args.reduce is not None:
        recipe = make((exact or wanted)[0], args.show if args.reduce is None else args.reduce)
        if args.reduce is not None:
            recipe = reduced(recipe, args.limit, args.fault)
            print(recipe.script())
            print(line(guarded(recipe, args.limit)))
            return 0
        show(recipe)
        return 0
    low, _, high = args.seeds.partition(":")
    runs, began = [], time.monotonic()
    for seed in range(int(low or 0), int(high or int(low) + 1)):
        for family in exact if len(exact) == len(args.families.split(",")) else wanted:
            try:
                found = guarded(make(family, seed), args.limit)
            except cvi.ContactviError as error:
                found = {"family": family, "seed": seed, "kinds": "", "faults": [], "e": "", "mu": "",
                         "class": "refused", "message": f"{type(error).__name__}: {error}"[:300]}  # fmt: skip
            runs.append(found)
            if found["class"] != "ok":
                print(line(found), flush=True)
            if args.json:
                with args.json.open("a") as file:
                    file.write(json.dumps(found, default=float) + "\n")
    print(f"\n{summary(runs)}\n{len(runs)} runs in {time.monotonic() - began:.0f} s")
    return int(any(found["class"] in ("wrong", "crash") for found in runs))
