"""
Carious or healthy by the force alone
=====================================

A round bur moves straight down the fossa of two molars. One of them has a lesion 3 mm deep. A
threshold on the axial force classifies each tick as carious or sound. The example computes the
largest share of correct classifications, and the probability that the force in a carious tick is
smaller than the force in a sound tick. Then the sound tooth is drilled at half the feed.

Expected:

- Over the whole lesion, the force in the carious tooth is 0.16 of the force in the sound tooth. The
  ratio is 0.09 in enamel and 0.59 in dentin.
- The best threshold classifies 95 % of all ticks correctly. Errors occur because decayed enamel is
  at first harder than sound dentin. In dentin, the threshold classifies all ticks correctly.
- The threshold is valid for one feed only. At half the feed, it classifies all sound dentin as
  carious.

The forces have no noise and depend on coefficients of low confidence
(`tissue/materials/cutting.toml`). The example does not show how well a person would discriminate
carious from sound tissue.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

import tissue

Floats = NDArray[np.float64]
FIGURES = Path("figures")
FIGURES.mkdir(exist_ok=True)
DEPTH_MM = 3.4
FEED_MM_S = 1.5

# %%
# There are three runs: the sound tooth, the carious tooth, and the sound tooth at half the feed.
# The voxels have a size of 0.1 mm, and the stress computation is switched off.


def drill(scene: str, feed_mm_s: float) -> tissue.Run:
    """Drill straight down into a built-in tooth."""
    changes = {
        # twice the spacing of the built-in scene, so an eighth of the number of voxels
        "voxels.spacing_mm": 0.1,
        "motion.points_mm": [[0, 0, 0.2], [0, 0, -DEPTH_MM]],
        "motion.feed_mm_s": feed_mm_s,
        "duration_s": (0.2 + DEPTH_MM) / feed_mm_s,
        "stress": None,
    }
    return tissue.simulate(tissue.load_scene(scene, changes))


sound = drill("molar", FEED_MM_S).trace
carious = drill("caries", FEED_MM_S).trace
slow = drill("molar", 0.5 * FEED_MM_S).trace

# %%
# The best threshold classifies the most ticks correctly. Carious and sound ticks have equal weight.
# The area under the ROC curve is the probability that the force in a carious tick is below the
# force in a sound tick.


def best_threshold(soft: Floats, hard: Floats) -> tuple[float, float, float]:
    """Return the best threshold [N], its share of correct ticks and the area under the ROC curve.

    A tick with a force below the threshold is classified as carious.
    """
    levels = np.unique(np.concatenate([soft, hard]))
    thresholds = 0.5 * (levels[1:] + levels[:-1])
    below = np.searchsorted(np.sort(soft), thresholds) / len(soft)
    above = 1.0 - np.searchsorted(np.sort(hard), thresholds) / len(hard)
    best = int(np.argmax(below + above))
    area = 1.0 - np.searchsorted(np.sort(hard), soft, side="right").mean() / len(hard)
    # mean of the shares of correct ticks in both groups, so that both groups have equal weight
    return float(thresholds[best]), float(0.5 * (below + above)[best]), float(area)


soft = carious["model_force_z_N"]
hard = sound["model_force_z_N"]
lesion = carious["layer"] == "caries"
parts = {
    "the lesion": lesion,
    "its part in enamel": lesion & (sound["layer"] == "enamel"),
    "its part in dentin": lesion & (sound["layer"] == "dentin"),
}
found = {}
print("over                 sound   carious  ratio  threshold  right   area")
for name, ticks in parts.items():
    means = hard[ticks].mean(), soft[ticks].mean()
    level, right, area = best_threshold(soft[ticks], hard[ticks])
    found[name] = means[1] / means[0], level, right
    figures = f"{means[0]:.3f} N  {means[1]:.3f} N  {means[1] / means[0]:5.3f}  {level:7.3f} N"
    print(f"{name:<19}  {figures}  {right:5.1%}  {area:.3f}")
threshold_N = found["its part in dentin"][1]
alarms = float((slow["model_force_z_N"][slow["layer"] == "dentin"] < threshold_N).mean())
print(f"at half the feed {alarms:.0%} of the sound tooth's dentin is below {threshold_N:.3f} N")

for name, ratio, right in zip(parts, (0.159, 0.094, 0.592), (0.953, 0.974, 1.0), strict=True):
    assert abs(found[name][0] - ratio) < 0.005
    assert abs(found[name][2] - right) < 0.01
assert alarms > 0.9

# %%
# At half the feed, the force in sound dentin is below the threshold that separates sound from
# carious at full feed.

figure, axes = plt.subplots(figsize=(8, 4.4), layout="constrained")
shaded = -carious["tool_z_mm"][lesion]
axes.axvspan(
    shaded[0], shaded[-1], color="#E69F00", alpha=0.2, linewidth=0, label="mostly in the lesion"
)
for trace, colour, line, label in (
    (sound, "#0072B2", "-", f"sound, {FEED_MM_S:g} mm/s"),
    (slow, "#56B4E9", "--", f"sound, {0.5 * FEED_MM_S:g} mm/s"),
    (carious, "#D55E00", "-", f"carious, {FEED_MM_S:g} mm/s"),
):
    met = trace["contact_mm2"] > 0.0
    axes.semilogy(
        -trace["tool_z_mm"][met],
        trace["model_force_z_N"][met],
        line,
        color=colour,
        label=label,
        lw=2,
    )
axes.axhline(
    threshold_N, color="0.3", linestyle=":", label=f"threshold in dentin, {threshold_N:.3f} N"
)
axes.set(xlabel="depth of the tip under the fossa / mm", ylabel="axial force / N", ylim=(0.02, 9.0))
axes.grid(alpha=0.3, which="both")
axes.legend(ncols=2, loc="upper right")
axes.set_title("Round bur of 1 mm down the fossa of a molar")
figure.savefig(FIGURES / "04_force.png", dpi=150)
