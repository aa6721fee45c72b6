"""A ball falls into the Allegro hand: where does it end, over restitution, friction and start?

A sweep by one call of contactvi.simulate_batch, in as many threads as there are cores. By default 180 runs; 10 000 of
them (--runs 10000) take some minutes.

python examples/batch_sweep.py [PICTURE.png] [--runs 180]
"""

import argparse
import time
import warnings
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import contactvi as cvi

parser = argparse.ArgumentParser()
parser.add_argument("picture", nargs="?")
parser.add_argument("--runs", type=int, default=180)
arguments = parser.parse_args()
DURATION, DT = 0.8, 1e-3  # [s]

scene = cvi.load_scene(Path(__file__).resolve().parents[1] / "models/allegro_ball.toml")
ball = scene.q_index("ball")
side = max(2, round(arguments.runs**0.35))  # values of restitution and of friction, starts of each
restitution, friction = np.meshgrid(np.linspace(0.05, 0.8, side), np.linspace(0.1, 1.0, side), indexing="ij")
starts = max(1, arguments.runs // side**2)
restitution, friction = (np.repeat(x.ravel(), starts)[:, None] for x in (restitution, friction))
q0s = np.tile(np.asarray(scene.q0), (len(friction), 1))
q0s[:, ball][:, :2] += np.random.default_rng(0).uniform(-0.04, 0.04, (len(q0s), 2))  # [m] on the palm

begin = time.perf_counter()
with warnings.catch_warnings():
    warnings.simplefilter("ignore", cvi.DenseStepWarning)  # of balls that come to rest
    result = cvi.simulate_batch(
        scene, q0s, scene.v0, parameters={"restitution": restitution, "friction": friction}, dt=DT, duration=DURATION,
        keep="ends", progress=True,
    )  # fmt: skip
seconds = time.perf_counter() - begin
held = result.ok & (result.q[:, ball][:, 2] > 0.0)  # [m] above the wrist: a ball that is lost falls far below
print(
    f"{len(result)} runs of {DURATION} s in {seconds:.1f} s: {int(held.sum())} balls held, {len(result.errors)} failed"
)
for k, error in list(result.errors.items())[:3]:
    print(f"run {k}: {error}")

if arguments.picture:
    figure, axes = plt.subplots(1, 2, figsize=(8, 3.4), layout="constrained", sharey=True)
    shown = {"share of the balls that the hand holds": held, "impacts of a run": result.impacts}
    for panel, (title, values) in zip(axes, shown.items(), strict=True):
        mean = values.reshape(side, side, starts).mean(axis=2)
        image = panel.imshow(mean.T, origin="lower", extent=(0.05, 0.8, 0.1, 1.0), aspect="auto")
        panel.set(xlabel="restitution", title=title)
        figure.colorbar(image)
    axes[0].set(ylabel="friction")
    figure.savefig(arguments.picture, dpi=100)

k = int(np.flatnonzero(result.ok)[0])  # a run of the batch is the run alone, to the bit
own = scene.with_parameters({"restitution": restitution[k], "friction": friction[k]})
with warnings.catch_warnings():
    warnings.simplefilter("ignore", cvi.DenseStepWarning)
    alone = cvi.simulate(own, q0s[k], scene.v0, dt=DT, duration=DURATION)
assert (alone.q[-1] == result.q[k]).all()
assert result.ok.mean() > 0.9
