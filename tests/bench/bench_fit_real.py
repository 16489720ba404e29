"""Constants fitted to one half of a real log predict the other half.

`python tests/bench/bench_fit_real.py --data ForceCalculation` after `git clone
https://github.com/leekunhwee/ForceCalculation`. The repository states no licence: files are read
where they are, and none of them is copied here.

Slots 25 mm wide and 3 mm deep in a metal, by a flat end mill with two teeth at 6000 rpm and five
feeds, 1 s of each, forces by a dynamometer at 10 kHz (folder `General/Flat end milling`). Not bone,
and so a test of the fit alone: the scene is a block that a cylinder cuts, coefficients have the
wide priors of a light alloy, poses follow from the stated feeds, axes are those that the author
uses. Some feeds are fitted. Printed of the others: mean forces, predicted with 90 % intervals;
their error, that of straight lines through the fitted means (the law is linear in the feed, and can
do no more), that of the priors' medians; and the scatter of means over a revolution, which is what
the same cut repeats to.
"""

import argparse
import os
import tempfile
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402

import tissue  # noqa: E402
from tissue.fitting.cutting import cutting_forward  # noqa: E402

FEEDS = (300, 600, 900, 1200, 1500)
"""Feeds of the logs [mm/min]."""
SPLITS = {"between": (300, 900, 1500), "beyond": (300, 600, 900)}
"""Feeds that are fitted; the others are predicted."""
RATE, REVOLUTION = 10_000, 100
"""Samples of a second, and of a revolution."""
START_MM, DEPTH_MM = -45.0, 3.0
SCENE = {
    "anatomy.size_mm": [100, 40, 5],
    "voxels.spacing_mm": 0.5,
    "tool.kind": "cylinder",
    "tool.diameter_mm": 25.0,
    "tool.length_mm": 6.0,
    "tool.flutes": 2,
    "tool.spin_rpm": 6000.0,
    "tool.shell_spacing_mm": None,
}
PRIORS = {
    "tangential_chip_N_mm2": (800.0, 200.0, 3000.0),
    "radial_chip_N_mm2": (300.0, 50.0, 1500.0),
    "axial_chip_N_mm2": (150.0, 20.0, 1000.0),
    "tangential_edge_N_mm": (15.0, 3.0, 60.0),
    "radial_edge_N_mm": (15.0, 3.0, 60.0),
    "axial_edge_N_mm": (10.0, 1.0, 50.0),
}
"""Priors of the coefficients.

Light alloys and soft steels lie within them (Altintas 2012, Manufacturing Automation, table 2.1,
from memory).
"""
STEP = 1e-4
"""Step over which the forces are differenced."""


def forces(folder: Path, feed: int) -> np.ndarray:
    """Forces on the tool, along the feed, across it and along the axis [N], shape (10000, 3)."""
    path = folder / "General" / "Flat end milling" / f"6-n6000f{feed}ap3ae25.csv"
    table = np.loadtxt(path, delimiter=",", skiprows=20, encoding="latin1")
    return np.asarray(table[:RATE, [2, 1, 3]] * [1.0, 1.0, -1.0])


def poses(feeds: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and tips [mm] of one second at each feed, one behind the other."""
    speeds = np.repeat(np.array(feeds) / 60.0, RATE)
    tips = np.zeros((len(speeds), 3))
    tips[:, 0] = START_MM + np.concatenate([[0.0], np.cumsum(speeds)[:-1]]) / RATE
    tips[:, 2] = -DEPTH_MM
    return np.arange(len(speeds)) / RATE, tips


def fitted(scene: tissue.Scene, data: Path, feeds: tuple[int, ...], folder: Path) -> tissue.Fit:
    times, tips = poses(feeds)
    log = np.column_stack([times, tips, np.concatenate([forces(data, feed) for feed in feeds])])
    names = "time_s,tool_x_mm,tool_y_mm,tool_z_mm,force_x_N,force_y_N,force_z_N"
    np.savetxt(folder / "log.csv", log, fmt="%.7g", delimiter=",", header=names, comments="")
    return tissue.fit(scene, folder / "log.csv", free=["cutting.chip", "cutting.edge"])


def predicted(scene: tissue.Scene, fit: tissue.Fit) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean forces at every feed [N], of the fit and of the priors' medians.

    For the fit they are the 5, 50 and 95 % quantiles, shape (3, feeds, 3).
    """
    times, tips = poses(FEEDS)
    every = slice(None, None, REVOLUTION)
    upright = np.tile([0.0, 0.0, 0.0, 1.0], (len(times[every]), 1))
    free = [name for name in fit.fitted.posterior.names if name.startswith("cutting.")]
    forward = cutting_forward(scene, times[every], 1e-3 * tips[every], upright, free=free)
    middle = [np.abs(forward.times_s - at - 0.5) < 0.25 for at in range(len(FEEDS))]
    posterior = fit.fitted.posterior

    def means(u: np.ndarray) -> np.ndarray:
        loads = forward.loads(posterior.target.x(u[: len(posterior.names)]))[:, :3]
        return (
            np.array([loads[at].mean(axis=0) for at in middle]) + posterior.target.unpacked(u).bias
        )

    best = means(posterior.maximum)
    slopes = np.stack(
        [
            (means(posterior.maximum + STEP * each) - best) / STEP
            for each in np.eye(posterior.target.size)
        ]
    )
    half = 1.645 * np.sqrt(np.einsum("ijk,il,ljk->jk", slopes, posterior.covariance, slopes))
    return np.array([best - half, best, best + half]), means(np.zeros(posterior.target.size))


def stated(material: str, ranges: dict[str, tuple[float, float, float]]) -> str:
    """A file of constants for a scene."""
    return "".join(
        (
            f"[{material}.{name}]\nvalue = {value}\nrange = [{low}, {high}]\nsource = "
            '"wide"\nconfidence = "L"\n'
        )
        for name, (value, low, high) in ranges.items()
    )


def milling(data: Path) -> None:
    """Fit some feeds, predict the others, print."""
    turns = np.array([forces(data, feed).reshape(-1, REVOLUTION, 3).mean(axis=1) for feed in FEEDS])
    measured, scatter = turns.mean(axis=1), turns.std(axis=1, ddof=1)
    results = {}
    for split, feeds in SPLITS.items():
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "metal.toml").write_text(stated("cutting.bone", PRIORS))
            scene = tissue.load_scene("milling", SCENE | {"materials": str(folder / "metal.toml")})
            fit = fitted(scene, data, feeds, folder)
            results[split], cited = predicted(scene, fit)
        print(f"fitted to {feeds} mm/min")
        print(
            fit.to_pandas()[["cited", "p05", "p50", "p95", "state"]].to_string(float_format="%.3g")
        )
        left = [at for at, feed in enumerate(FEEDS) if feed not in feeds]
        for at in left:
            for axis, name in enumerate("xyz"):
                low, value, high = results[split][:, at, axis]
                print(
                    f"  {FEEDS[at]:5d} mm/min {name}: measured {measured[at, axis]:7.1f} N "
                    "(scatter "
                    f"{scatter[at, axis]:.1f}), predicted {value:7.1f} ({low:.1f} to {high:.1f}), "
                    f"priors {cited[at, axis]:7.1f}"
                )
        lines = np.polynomial.polynomial.polyfit(feeds, measured[np.isin(FEEDS, feeds)], 1)
        straight = np.polynomial.polynomial.polyval(np.array(FEEDS), lines).T
        for name, each in (
            ("fit", results[split][1]),
            ("straight lines", straight),
            ("priors", cited),
        ):
            each = (each - measured)[left]
            size = np.linalg.norm(measured[left])
            print(
                f"  {name}: off {np.linalg.norm(each) / size:.1%} of the force (root mean square), "
                f"{np.sqrt(np.mean(each**2)):.1f} N against a scatter of "
                f"{np.sqrt(np.mean(scatter[left] ** 2)):.1f} N"
            )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True)
    options = parser.parse_args()
    if not options.data.is_dir():
        parser.exit(0, f"skipped: no folder {options.data}; see above for where the logs are\n")
    milling(options.data)


if __name__ == "__main__":
    main()
