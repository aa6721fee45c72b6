"""A slider-crank whose slider has clearance in its channel (Flores, Leine, Glocker 2010): h against h/4.

python examples/slider_crank_clearance.py [PLAYBACK.html]
"""

import sys
from pathlib import Path

import numpy as np

import contactvi as cvi

models = Path(__file__).resolve().parents[1] / "models"
half_height, clearance = 0.025, 0.001  # of the slider and of the channel on either side [m]
# From an event-located Runge-Kutta run with the corners' Newton impact law, both corners of a side at once.
reference = [0.002692502752, 0.005612363190, 0.007475056212, 0.008421767934, 0.008845705250]

scene = cvi.Scene()
scene.add_urdf(models / "slider_crank.urdf", limits=False)
scene.add_halfspace((0, 0, -1), -(half_height + clearance), "upper_wall")
scene.add_halfspace((0, 0, 1), -(half_height + clearance), "lower_wall")
scene.set_contact(restitution=0.4, friction=0.01)
# Stretched; crank at 150 rad/s, rod at -75 rad/s, slider without spin: differences, as the joints' angles are relative.
v0 = scene.velocity({"hinge_crank": 150.0, "hinge_rod": -225.0, "hinge_slider": 75.0})

runs, gains, balance = [], [], []
for dt in (1e-5, 2.5e-6):
    traj = cvi.simulate(scene, v0=v0, duration=0.2, dt=dt)
    runs.append(traj)
    gains.append(max(event.energy_change for event in traj.events))
    times = traj.events.array("time")
    first = np.abs(times[:5] - reference).max()
    print(
        f"h {dt:.1e} s  {len(traj.events)} impacts, {len(traj.contact_changes)} changes of persistent contact, ", end=""
    )
    print(f"energy {traj.energy[0]:.5f} -> {traj.energy[-1]:.5f} J, largest change at an impact {gains[-1]:.1e} J")
    print(f"    first five impacts off by {first:.1e} s, lost at impacts {traj.impact_loss[-1]:.5f} J, ", end="")
    balance.append(np.abs(traj.ledger.energy_balance).max())
    print(f"by sliding {traj.friction_loss[-1]:.5f} J, balance off by {balance[-1]:.1e} J")

coarse, fine = runs
difference = np.abs(coarse.q - fine.q[::4]).max()
print(f"h against h/4: angles differ by {difference:.1e} rad after {coarse.q[-1, 0] / (2 * np.pi):.2f} turns")
if len(sys.argv) > 1:
    coarse.to_html(sys.argv[1], overwrite=True, title="slider-crank with clearance")
if max(gains) > 0.0 or first > 1e-7 or difference > 1e-4 or balance[1] > balance[0] / 12:
    raise SystemExit("an impact gains energy, loses some unaccounted for, or the two runs part")
