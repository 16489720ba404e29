"""
Needle through the capsule of a liver
=====================================

A needle is pushed through the capsule of a liver and a vessel wall. The needle is then drawn out
and pushed in again along its track.

Expected:

- The capsule is punctured at a travel of 16.9 mm and a force of 2.30 N. The force then drops by
  0.67 N, but not down to the cutting force alone. The edge of the hole still carries 0.65 N, and
  the organ stays deflected by 13.7 mm.
- After the puncture the force increases by 11.6 N per metre of needle in the organ.
- The vessel wall, 30 mm deep in the organ, breaks at 49.9 mm of travel with 3.00 N.
- When the needle is drawn back, the shaft sticks for 32.6 mm of travel before it slides. The organ
  pulls the needle with up to 1.91 N.
- The second insertion needs 59 % of the work of the first insertion, because the needle punctures
  no membrane and cuts no tissue.

The constants of liver are a published fit to one needle (Okamura 2004). The constants of the vessel
wall have no source (`tissue/materials/needle.toml`). The force curve is therefore fitted, not
predicted. If the constants are drawn from their ranges, 90 % of the punctures lie between 13.7 and
20.2 mm (`tissue run needle --band 200`). Of the forces at the vessel wall, 90 % lie between 2.4 and
4.2 N, with a median of 3.1 N (with this example's `changes` and `--band 128`).
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tissue

FIGURES = Path("figures")
FIGURES.mkdir(exist_ok=True)
FEED_MM_S = 5.0
DEEP_MM = 70.0
OUT_MM = -20.0
WALL_MM = 30.0

# %%
# In the scene `needle`, the path goes in, out and in again. The travel is measured from the
# undeformed surface.

changes = {
    "anatomy.membrane_depths_mm": {"vessel wall": WALL_MM},
    "anatomy.interval_ms": 0.0,
    "motion.points_mm": [[0, 0, -z] for z in (-2.0, DEEP_MM, OUT_MM, DEEP_MM)],
    "motion.feed_mm_s": FEED_MM_S,
}
run = tissue.simulate(tissue.load_scene("needle", changes))
trace = run.trace
travel = -trace["tool_z_mm"]
force = trace["model_force_z_N"]
for time_s, event in run.events:
    print(f"after {time_s:5.2f} s: {event}")

# %%
# At the puncture of the capsule the force drops. The edge of the hole still holds the needle.

first = int(np.flatnonzero(travel > DEEP_MM - 1e-6)[0])
last = first + int(np.argmin(travel[first:]))
puncture = int(np.argmax(force[:first] * (travel[:first] < 20.0)))
drop = force[puncture] - force[puncture + 1]
held = trace["elastic_N"][puncture + 1]
deflection = trace["deflection_mm"][puncture + 1]
print(f"capsule: {force[puncture]:.2f} N at {travel[puncture]:.1f} mm, drop {drop:.2f} N")
print(
    f"left after it: {held:.2f} N held by the hole's edge, the organ deflected by "
    f"{deflection:.1f} mm"
)
assert abs(force[puncture] - 2.30) < 0.01 and abs(travel[puncture] - 16.9) < 0.05
assert abs(drop - 0.67) < 0.01 and abs(held - 0.65) < 0.001 and abs(deflection - 13.7) < 0.05

# %%
# After that, the friction along the shaft increases with the length of needle in the organ. Then
# the needle breaks through the vessel wall.

insertion = trace["insertion_mm"]
sliding = slice(puncture + 1, int(np.flatnonzero(insertion == WALL_MM)[0]))
slope = np.polyfit(1e-3 * insertion[sliding], force[sliding], 1)[0]
wall = int(np.argmax(force[:first]))
print(
    f"then {slope:.1f} N/m of needle in the organ; vessel wall: {force[wall]:.2f} N at "
    f"{travel[wall]:.1f} mm"
)
assert abs(slope - 11.6) < 0.1
assert abs(force[wall] - 3.00) < 0.01 and abs(travel[wall] - 49.9) < 0.05

# %%
# When the needle is drawn back, the shaft sticks before it slides. In the second insertion, the
# capsule and the vessel wall are already open.

back = slice(first, last)
stuck = DEEP_MM - travel[back][insertion[back] == insertion[first]].min()
pull = -force[back].min()
print(f"drawn back: sticks over {stuck:.1f} mm, pulls with up to {pull:.2f} N")
assert abs(stuck - 32.6) < 0.1 and abs(pull - 1.91) < 0.01

work_mJ = [
    float(np.sum(0.5 * (force[part][1:] + force[part][:-1]) * np.diff(travel[part])))
    for part in (slice(first), slice(last, None))
]
share = work_mJ[1] / work_mJ[0]
print(f"work: {work_mJ[0]:.0f} mJ at first, {work_mJ[1]:.0f} mJ along the track, {share:.0%}")
assert abs(share - 0.59) < 0.01

# %%
# Plot the force as a function of travel, with its components during the first insertion.

figure, axes = plt.subplots(figsize=(8, 4.8), layout="constrained")
parts = [trace[name][:first] for name in ("elastic_N", "cutting_N", "friction_N")]
names = ("force of membranes", "cutting force at the tip", "friction along the shaft")
axes.stackplot(
    travel[:first], *parts, labels=names, colors=("#56B4E9", "#E69F00", "#009E73"), alpha=0.35
)
for part, colour, label in (
    (slice(first), "0.1", "first insertion"),
    (slice(first, last), "#D55E00", "withdrawal"),
    (slice(last, None), "#0072B2", "second insertion"),
):
    axes.plot(travel[part], force[part], color=colour, linewidth=1.8, label=label)
axes.axhline(0.0, color="0.4", linewidth=0.8)
axes.set(
    xlabel="travel of the tip from the undeformed surface / mm",
    ylabel="force against insertion / N",
)
axes.grid(alpha=0.3)
axes.legend(loc="upper left")
axes.set_title(f"Needle into a liver with a vessel wall {WALL_MM:g} mm deep, {FEED_MM_S:g} mm/s")
figure.savefig(FIGURES / "06_force.png", dpi=150)
