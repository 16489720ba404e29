"""Check that chosen settings hold where they were not measured.

Run: `python tests/bench/held_out.py --out DIR [--seeds N] [SCENE ...]`.

Every setting of a scene is measured on the scene's own motion, as `fidelity` does it, then on
others: feed x 0.8-1.25, depth x 0.9-1.1, the path moved sideways by up to half a voxel (half a
millimetre where no hole guides the tool). Imaged anatomy is measured in the same manner where
`../shared/anatomy` is available. Printed: the number of runs in which the choice of `fidelity`
keeps the demanded error, for several factors of safety.
"""

import argparse
import csv
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from harness import machine, table

from meshes.base.errors import InputError
from tissue.evaluation.charts import frontier as fidelity
from tissue.evaluation.charts import settings
from tissue.evaluation.charts.frontier import Frontier, frontier_of, undominated
from tissue.evaluation.charts.measure import force_and_reference_N, short_of
from tissue.evaluation.statistics.metrics import force_error
from tissue.scene.coupling import Fidelity
from tissue.scene.load import changed, load_scene
from tissue.scene.scene import Scene
from tissue.scene.tool import PathMotion
from tissue.simulation.simulate import simulate

SCENES = ("milling", "molar", "caries", "glenoid", "liver-press", "palpation")
ASIDE_MM = {"milling": 0.5, "molar": 0.5, "caries": 0.5, "liver-press": 0.5, "palpation": 0.5}
"""Distance by which a path is moved sideways where no hole guides the tool [mm]."""
DEMANDS = (0.003, 0.005, 0.01, 0.02, 0.03, 0.05, 0.08, 0.12, 0.2, 0.3)
"""Demanded errors."""
FACTORS = (1.0, 1.25, 1.5, 1.75, 2.0, 2.5)
"""Factors of safety that are tried in addition to the one in use."""
ROOT = Path(__file__).resolve().parents[3] / "shared" / "anatomy"
REAL: dict[str, dict[str, dict[str, Any]]] = {
    "glenoid": {
        "openforge scapula": {
            "anatomy.file": "scapula/openforge_scapula_left.stl",
            "anatomy.scale_mm": 50.0,
        },
        "myosim scapula": {"anatomy.file": "scapula/myosim_scapula.stl"},
    },
    "molar": {
        "carious tooth 2": {
            "anatomy.file": "tooth/caries_tooth_2.nii.gz",
            "anatomy.spacing_mm": 0.034,
        },
        "carious tooth 4": {
            "anatomy.file": "tooth/caries_tooth_4.nii.gz",
            "anatomy.spacing_mm": 0.034,
        },
    },
    "liver-press": {"scanned liver": {"anatomy.file": "liver/liver.vtk", "anatomy.scale_mm": 1.0}},
}
"""Anatomy that was imaged, by scene."""
FIRST_SEED = 21
"""Seeds before this one set the factor of safety."""


def moved(scene: Scene, seed: int) -> Scene:
    """The scene with a motion that was not measured."""
    motion, rng = scene.motion, np.random.default_rng(seed)
    assert isinstance(motion, PathMotion)
    feed, depth = rng.uniform(0.8, 1.25), rng.uniform(0.9, 1.1)
    most = ASIDE_MM.get(scene.name, 0.5 * scene.voxels.spacing_mm)
    aside = settings.moved(scene, *rng.uniform(-most, most, 2), depth=depth)
    paced = {
        "motion.feed_mm_s": round(feed * motion.feed_mm_s, 4),
        "duration_s": round((scene.duration_s or 1.0) / feed, 3),
    }
    return changed(aside, paced)


def subjects(name: str) -> Iterator[tuple[str, Scene]]:
    """The scene, and the same with each imaged anatomy."""
    scene = load_scene(name)
    yield name, scene
    for title, changes in REAL.get(name, {}).items():
        file = ROOT / changes["anatomy.file"]
        if file.exists():
            yield f"{name}, {title}", changed(scene, changes | {"anatomy.file": str(file)})
        else:
            print(f"{title}: {file.name} is not here")


def errors(
    name: str, scene: Scene, seeds: int, out: Path
) -> tuple[Frontier, dict[str, dict[str, float]]]:
    """Return the measurements of a scene and the error of its best settings on other runs.

    The other runs were not measured.

    What a call that was interrupted has found is not run again.
    """
    frontier, ran = frontier_of(scene, quick=True), out / f"{name}.csv"
    short, good = short_of(scene, True), {point.setting for point in undominated(frontier.points)}
    best = [setting for setting in frontier.settings if setting.name in good]
    found: dict[str, dict[str, float]] = {setting.name: {} for setting in best}
    if ran.exists():
        with ran.open(encoding="utf-8", newline="") as file:
            for setting, where, error in csv.reader(file):
                found.setdefault(setting, {})[where] = float(error)
    for seed in range(FIRST_SEED, FIRST_SEED + seeds):
        where, other = f"motion {seed}", moved(short, seed)
        left = [setting for setting in best if where not in found[setting.name]]
        try:
            for setting in left:
                run = simulate(changed(other, setting.changes), allow_unstable=True)
                found[setting.name][where] = force_error(
                    *force_and_reference_N(run, other, quick=True)
                )
                with ran.open("a", encoding="utf-8", newline="") as file:
                    csv.writer(file).writerow((setting.name, where, found[setting.name][where]))
        except InputError as refusal:
            print(f"{name}, {where}: {refusal}", flush=True)
    return frontier, {setting.name: found[setting.name] for setting in best}


def chosen(frontier: Frontier, demand: float, factor: float) -> str | None:
    """Return the setting that `fidelity` would choose with a factor of safety."""
    before, fidelity.SAFETY = fidelity.SAFETY, factor
    try:
        return fidelity.choose(
            frontier.points, Fidelity(force_error=demand), gap=frontier.gap
        ).setting
    except InputError:
        return None
    finally:
        fidelity.SAFETY = before


def report(
    name: str, frontier: Frontier, found: dict[str, dict[str, float]]
) -> dict[float, list[bool]]:
    """Print the settings chosen and return, by factor, the list of whether each held."""
    base = {point.setting: point.force_error for point in frontier.points}
    rows = []
    for setting, each in found.items():
        values = np.array(list(each.values()))
        ratio = values / base[setting] if base[setting] > 0.0 else np.full(len(values), np.nan)
        rows.append(
            (
                setting,
                f"{100 * base[setting]:.2g}",
                f"{100 * np.median(values):.2g}",
                f"{100 * values.max():.2g}",
                f"{np.quantile(ratio, 0.95):.2f}",
            )
        )
    print(
        f"\n{name}: error to the reference (known to {100 * frontier.gap:.2g} %) / %, as "
        f"measured and on {len(values)} other runs"
    )
    print(table(rows, ("setting", "measured", "median", "worst", "95 % of ratios")))
    verdicts: dict[float, list[bool]] = defaultdict(list)
    rows = []
    for demand in DEMANDS:
        cells = []
        for factor in sorted({fidelity.SAFETY, *FACTORS}):
            setting = chosen(frontier, demand, factor)
            if setting is None or setting not in found:
                cells.append("refused")
                continue
            met = [error <= demand for error in found[setting].values()]
            verdicts[factor] += met
            cells.append(f"{100 * np.mean(met):.0f} {setting}")
        rows.append((f"{100 * demand:g} %", *cells))
    print(
        table(
            rows, ("demanded", *(f"x {factor:g}" for factor in sorted({fidelity.SAFETY, *FACTORS})))
        )
    )
    return verdicts


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", help="default: " + ", ".join(SCENES))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument(
        "--out", type=Path, default=Path("held_out"), help="folder of what was found"
    )
    given = parser.parse_args()
    print(machine())
    names = given.scenes or SCENES
    together: dict[float, list[bool]] = defaultdict(list)
    given.out.mkdir(parents=True, exist_ok=True)
    for name in names:
        for subject, scene in subjects(name):
            try:
                frontier, found = errors(subject, scene, given.seeds, given.out)
            except InputError as refusal:
                print(f"{subject}: {refusal}", flush=True)
                continue
            for factor, met in report(subject, frontier, found).items():
                together[factor] += met
    print("\nall demands that were not refused, all runs")
    shares = [
        (f"x {f:g}", f"{100 * np.mean(met):.1f} %", str(len(met)))
        for f, met in sorted(together.items())
    ]
    print(table(shares, ("safety", "met", "runs")))


if __name__ == "__main__":
    main()
