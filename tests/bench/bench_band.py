"""Bands of built-in scenes: cost against the plain run, and error of their ends.

The error is taken against many samples.

``--published`` prints instead the figures of the documentation that rest on cited ranges, each with
its band.
"""

import argparse
from time import process_time

import numpy as np
from harness import machine
from scipy.optimize import brentq
from scipy.special import ndtri

from tissue.fitting.bands.band import band_of
from tissue.fitting.bands.sample import Ranges, normals
from tissue.fitting.bands.sample_loads import LEVELS, Reweighed
from tissue.materials.constants import Prior, constants
from tissue.scene.load import load_scene
from tissue.simulation.load_record import record_loads
from tissue.simulation.simulate import simulate

ENDS = (0.05, 0.5, 0.95)
SEEDS = range(10)


def spent_s(work):
    """Processor time of a call, after one that compiles."""
    started = process_time()
    found = work()
    return process_time() - started, found


def cost(name):
    """Cost of a band of 200 samples, in runs."""
    scene = load_scene(name)
    simulate(scene, cores=1)
    run_s, _ = spent_s(lambda: simulate(scene, cores=1))
    band_s, band = spent_s(lambda: band_of(scene, 200, cores=1))
    peak = band.summary["force_N"]["peak"]
    print(
        (
            f"{name}: run {run_s:.2f} s, band {band_s:.2f} s of processor time, "
            f"{band_s / run_s:.1f} runs; "
        ),
        end="",
    )
    print(f"peak force {peak['p50']:.1f} N, 90 % {peak['p05']:.2f} to {peak['p95']:.1f} N")


def convergence():
    """Root mean square error over seeds of the quantiles of milling's peak force."""
    reweighed = Reweighed(record_loads(load_scene("milling"), cores=1))
    width = len(reweighed.ranges.names)

    def ends(count, seed):
        figures = reweighed.figures(reweighed.ranges.x(normals(count, width, seed=seed)))
        return np.quantile(figures[:, 0], ENDS)

    reference = np.mean([ends(4096, 100 + seed) for seed in range(4)], axis=0)
    for count in (64, 256, 1024):
        errors = np.array([ends(count, seed) for seed in SEEDS]) / reference - 1.0
        print(
            f"{count} samples: 5, 50, 95 % of the peak off by "
            f"{np.sqrt((errors**2).mean(axis=0)).round(4)}"
        )


def slope():
    """Return the error of the 95 % quantile of a force that is a sum, against its closed form.

    It is the root mean square over seeds.
    """
    names = ("tangential_edge_N_mm", "radial_edge_N_mm", "radial_chip_N_mm2")
    priors = tuple(Prior.of(constants("cutting", "bone")[name], name) for name in names)
    ranges = Ranges(names, priors, np.eye(len(names)))
    weights = np.array([1.0, 1.0, 0.02])
    z = np.linspace(-9.0, 9.0, 20001)
    share = np.exp(-0.5 * z * z) / np.exp(-0.5 * z * z).sum()
    two = np.cumsum(share)
    grids = [weight * prior.x(z) for weight, prior in zip(weights, ranges.priors, strict=True)]
    fine = ndtri((np.arange(600) + 0.5) / 600)
    last = np.add.outer(
        *(
            weight * prior.x(fine)
            for weight, prior in zip(weights[1:], ranges.priors[1:], strict=True)
        )
    )

    def below(force):
        return float(np.interp(force - last.ravel(), grids[0], two, left=0.0, right=1.0).mean())

    exact = brentq(lambda force: below(force) - 0.95, 1.0, 60.0, xtol=1e-9)
    counts = 2 ** np.arange(6, 15)
    errors = []
    for count in counts:
        found = [
            np.quantile(ranges.x(normals(count, 3, seed=seed)) @ weights, 0.95)
            for seed in range(40)
        ]
        errors.append(np.sqrt(np.mean((np.array(found) / exact - 1.0) ** 2)))
    order = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    print(
        "95 % quantile of a sum of three: "
        f"{dict(zip(counts.tolist(), np.round(errors, 5).tolist(), strict=True))}"
    )
    print(f"error falls with the number of samples to the power {order:.2f}; of random samples 0.5")


COUNT = 4096
"""Samples behind a published band; its ends are off by some 1 %."""
NEAR_2_MM = {
    "voxels.spacing_mm": 0.2,
    "motion.points_mm": [[0, 0, -0.1], [0, 0, -2.0]],
    "motion.feed_mm_s": 2.0,
    "tool.spin_rpm": 2000.0,
    "duration_s": 1.0,
}
"""The glenoid of tests/verification/test_cutting_forces.py."""
STRAIGHT_DOWN = {
    "voxels.margin_mm": 1.5,
    "motion.points_mm": [[0, 0, 0.2], [0, 0, -4.4]],
    "motion.feed_mm_s": 1.5,
    "duration_s": 4.6 / 1.5,
    "stress": None,
}
"""The molar of examples/03_drill_through_the_layers.py."""


class Windows:
    """Loads of a scene in parts of its run.

    They are computed at the cited constants and in samples of all constants.
    """

    def __init__(self, name, changes):
        self.reweighed = Reweighed(record_loads(load_scene(name, changes), cores=1))
        ranges = self.reweighed.ranges
        self.trace = self.reweighed.record.trace
        self.nominal = self.reweighed.weights(self.reweighed.nominal()[None])
        values = ranges.x(normals(COUNT, len(ranges.names), seed=0))
        self.weights = self.reweighed.weights(values)

    def loads(self, ticks):
        """Return the mean over ticks of force [N] and torque [N m].

        The shapes are (6,) at the cited constants and (samples, 6).
        """
        units = [
            layer.unit[:, :, ticks].mean(axis=2) for layer in self.reweighed.record.layers.values()
        ]
        unit = np.concatenate([each.reshape(-1, 6) for each in units])
        return (self.nominal @ unit)[0], self.weights @ unit

    def show(self, label, ticks, value):
        """Print a figure with its band; `value` makes it of loads."""
        nominal, samples = self.loads(ticks)
        row(label, value(nominal[None])[0], np.quantile(value(samples), tuple(LEVELS.values())))


def row(label, nominal, ends):
    low, quarter, middle, upper, high = (f"{each:.3g}" for each in ends)
    print(f"| {label} | {nominal:.3g} | {middle} | {quarter} to {upper} | {low} to {high} |")


def middle_half(ticks):
    return ticks[len(ticks) // 4 : -(len(ticks) // 4)]


def published():
    """Each figure at the cited constants, its median, 50 and 90 % band."""
    print("| figure | cited | median | 50 % | 90 % |")
    print("|---|---|---|---|---|")
    size = lambda first: lambda loads: np.linalg.norm(loads[:, first : first + 3], axis=1)  # noqa: E731
    glenoid = Windows("glenoid", NEAR_2_MM)
    late = np.arange(1000)[-120:-60]
    glenoid.show("glenoid at 2 mm: thrust / N", late, lambda loads: loads[:, 2])
    glenoid.show("glenoid at 2 mm: torque / N m", late, lambda loads: loads[:, 5])
    molar = Windows("molar", STRAIGHT_DOWN)
    for layer in ("enamel", "dentin"):
        ticks = middle_half(np.flatnonzero(molar.trace["layer"] == layer))
        molar.show(
            f"molar at 1.5 mm/s: axial force in {layer} / N", ticks, lambda loads: loads[:, 2]
        )
    milling = Windows("milling", {"duration_s": 1.6})
    milling.show(
        "milling, middle of the first pass: size of the force / N", np.arange(530, 1530), size(0)
    )
    for name, changes in (("glenoid", {}), ("milling", {}), ("molar", {}), ("caries", {})):
        whole = Reweighed(record_loads(load_scene(name, changes), cores=1))
        values = whole.ranges.x(normals(COUNT, len(whole.ranges.names), seed=0))
        figures, nominal = whole.figures(values), whole.figures(whole.nominal()[None])[0]
        ends = np.quantile(figures, tuple(LEVELS.values()), axis=0)
        row(f"{name}: peak force / N", nominal[0], ends[:, 0])
        row(f"{name}: peak torque / N m", nominal[2], ends[:, 2])
    needle = load_scene("needle", {"anatomy.interval_ms": 0.0, "duration_s": 1.6})
    band, run = band_of(needle, 256, cores=1), simulate(needle, cores=1)
    (punctured,) = (
        each for sentence, each in band.summary["events"].items() if "capsule" in sentence
    )
    row(
        "needle: time of the capsule's puncture / s",
        run.events[0][0],
        list(punctured["time_s"].values()),
    )
    tick = int(np.searchsorted(band.times_s, 0.25 + 16.7 / 20.0))
    row("needle: force at 16.7 mm / N", band.nominal[tick, 3], band.quantiles[:, tick, 3])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--published", action="store_true")
    print(machine())
    if parser.parse_args().published:
        published()
    else:
        for name in ("milling", "glenoid"):
            cost(name)
        convergence()
        slope()
