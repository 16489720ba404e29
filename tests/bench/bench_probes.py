"""Elastic laws against measured presses of pig liver: held-out error next to the noise.

Run: `python tests/bench/bench_probes.py [--thickness MM ...] [--laws NAME ...] [--splits N]`.

The presses (`../shared/measured`, vu-arma-dev/robot-palpation-data) are not part of the project;
without them the script prints so and ends. For each region and law, half of the presses is fitted,
and the fitted curve is compared with the median of the other half. Next to it stands the difference
of the two medians, which no law can go below. A law counts as worse than the best only if its error
exceeds the best one's by more than this noise.
"""

import argparse
import csv
from collections import defaultdict
from pathlib import Path

import numpy as np
from harness import machine, table

from tissue.fitting.log_files import LogColumns
from tissue.fitting.probe_fit import fit_curves, median_curve
from tissue.fitting.probe_laws import ProbeCurves, layer_scene, probe_curves, shape_keys
from tissue.fitting.probe_table import ProbeTable, at_common_depths, read_presses
from tissue.scene.load import load_scene

FILE = Path(__file__).resolve().parents[3] / "shared" / "measured" / "pig_liver_probing.csv"
RADIUS_MM = 4.0
"""Radius of the ball of these presses."""
LAWS = {
    "linear": {},
    "neo-hookean": {},
    "mooney-rivlin": {"second_share": 0.5},
    "ogden": {"exponent": 8.0},
    "yeoh square": {"square_ratio": 1.0},
    "yeoh": {"square_ratio": 1.0, "cube_ratio": 1.0},
    "exponential": {"exponential_rate": 3.0},
}
"""Starting constants of the laws; those above zero are fitted."""
QUICK = ("linear", "neo-hookean", "ogden", "yeoh square", "exponential")
SEED = 7
FORCE_AT_MM = 2.93


def regions() -> dict[str, ProbeTable]:
    """Return the presses of each file of the measurement."""
    rows: dict[str, list[dict[str, str]]] = defaultdict(list)
    with FILE.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            rows[row["file"]].append(row)
    found = {}
    for name, of in rows.items():
        columns = {
            wanted: np.array([float(row[column]) for row in of])
            for wanted, column in (
                ("probe", "probe"),
                ("depth_mm", "depth_mm"),
                ("force_N", "normal_force_N"),
            )
        }
        read = read_presses(FILE, LogColumns(tuple(columns), columns.__getitem__))
        found[name] = at_common_depths(FILE, *read)
    return found


def curves_of(law: str, thickness_mm: float, depths_m: np.ndarray) -> ProbeCurves:
    """Return the forces of a law on a layer of liver at fine depths."""
    keys = {
        "anatomy.size_mm": [100, 100, thickness_mm],
        "anatomy.nodule_diameter_mm": 0.0,
        "tool.diameter_mm": 2.0 * RADIUS_MM,
        "organ.parts": None,
        "organ.young_kPa": None,
        "organ.young_end_kPa": None,
        "organ.law": law.split()[0],
    }
    keys |= {f"organ.{name}": value for name, value in LAWS[law].items()}
    layer = layer_scene(load_scene("palpation", keys))
    return probe_curves(layer, depths_m, shape_keys(layer.organ))


def at_depths(curves: ProbeCurves, fine_m: np.ndarray, depths_m: np.ndarray) -> ProbeCurves:
    """Return the curves at the depths of a region."""
    unit = np.stack([np.interp(depths_m, fine_m, each) for each in curves.unit_N_Pa])
    return ProbeCurves(curves.keys, curves.shapes, unit)


def split_medians(presses: ProbeTable, splits: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the median curves of two random halves, shape (splits, depths) both."""
    random = np.random.default_rng(SEED)
    count = len(presses.forces_N)
    orders = np.array([random.permutation(count) for _ in range(splits)])
    return tuple(
        median_curve(presses.forces_N, part)
        for part in (orders[:, : count // 2], orders[:, count // 2 :])
    )


def relative(found: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return the L2 norm of differences over that of the wanted curves, shape (splits,)."""
    return np.linalg.norm(found - wanted, axis=1) / np.linalg.norm(wanted, axis=1)


def interval(values: np.ndarray, form: str = ".3g") -> str:
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
    return f"{middle:{form}} ({low:{form}} to {high:{form}})"


def percent(values: np.ndarray) -> str:
    return interval(100.0 * values, ".2g")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--thickness", type=float, nargs="+", default=[10.0], help="of the layer")
    parser.add_argument("--laws", nargs="+", choices=tuple(LAWS), default=list(QUICK))
    parser.add_argument("--splits", type=int, default=200)
    given = parser.parse_args()
    print(machine())
    if not FILE.exists():
        print(f"{FILE.name} is not here: it is kept outside the project, since it has no licence")
        return
    found = regions()
    deepest_m = max(float(each.depths_m[-1]) for each in found.values())
    fine_m = np.linspace(0.0, deepest_m, 150)
    for thickness_mm in given.thickness:
        solved = {law: curves_of(law, thickness_mm, fine_m) for law in given.laws}
        rows, constants = [], []
        for name, presses in found.items():
            first, second = split_medians(presses, given.splits)
            noise = relative(first, second)
            errors, at_mm = {}, {}
            draws = np.random.default_rng(SEED).integers(
                0, len(presses.forces_N), (500, len(presses.forces_N))
            )
            for law, curves in solved.items():
                here = at_depths(curves, fine_m, presses.depths_m)
                errors[law] = relative(fit_curves(here, first).force_N, second)
                drawn = fit_curves(here, median_curve(presses.forces_N, draws))
                shape = ", ".join(
                    f"{key} {interval(drawn.shape[:, at])}" for at, key in enumerate(here.keys)
                )
                whole = fit_curves(here, median_curve(presses.forces_N)[None])
                at_mm[law] = np.interp(
                    FORCE_AT_MM, 1e3 * presses.depths_m, whole.force_N[0] - whole.bias_N[0]
                )
                constants.append((name, law, interval(1e-3 * drawn.modulus_Pa), shape))
            best = min(float(np.median(each)) for each in errors.values())
            cells = []
            for each in errors.values():
                # A law ranks below the best only where the noise does not explain it.
                behind = float(np.median(each)) - best > float(np.median(noise))
                cells.append(f"{percent(each)}{' *' if behind else ''}")
            rows.append((name, str(len(presses.forces_N)), percent(noise), *cells))
        print(
            f"\nlayer of {thickness_mm:g} mm: error of the median of held-out presses / %, median "
            f"(5 to 95 %) of {given.splits} splits; * worse than the best by more than the noise"
        )
        print(table(rows, ("region", "presses", "noise", *solved)))
        print("\nconstants, median (5 to 95 %) of 500 draws of the presses")
        print(table(constants, ("region", "law", "Young's modulus / kPa", "shape")))


if __name__ == "__main__":
    main()
