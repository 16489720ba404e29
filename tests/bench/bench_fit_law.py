"""Recovery of modulus and shape of a hyperelastic law from a deep press.

Also reports how smooth the runs of the law are.

python tests/bench/bench_fit_law.py ogden --fits 8
python tests/bench/bench_fit_law.py mooney-rivlin --fits 4
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import tissue
from tissue.fitting.organ_runs import OrganRuns, Poses

SLAB = {
    "anatomy.size_mm": [50, 40, 20],
    "anatomy.nodule_diameter_mm": None,
    "anatomy.edge_mm": 8.0,
    "anatomy.touch_edge_mm": 5.0,
    "organ.young_kPa": 8.0,
    "organ.young_end_kPa": None,
    "organ.parts": None,
    "organ.friction": 0.0,
    "organ.poisson_ratio": 0.45,
    "organ.order": 1,
    "organ.interval_ms": 0.0,
}
LAWS = {"ogden": ("organ.exponent", 12.0, 18.0), "mooney-rivlin": ("organ.second_share", 0.3, 0.6)}
"""Key of the shape, the scene's value, and the planted one."""
TIMES_S, DEPTHS_MM = np.array([0.0, 0.4, 0.6, 0.9]), np.array([0.5, -5.0, -5.0, -1.0])
NOISE_N, PLANTED_KPA, FIRST_SEED = 2e-3, 6.0, 7
STEPS = (0.001, 0.01)
"""Relative steps of the shape between two runs."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("law", choices=LAWS)
    parser.add_argument("--fits", type=int, default=4)
    given = parser.parse_args()
    key, stated, planted = LAWS[given.law]
    scene = tissue.load_scene("palpation", SLAB | {"organ.law": given.law, key: stated})
    tips = np.column_stack([np.zeros((4, 2)), DEPTHS_MM])
    poses = Poses(TIMES_S, 1e-3 * tips, np.tile([0.0, 0.0, 0.0, 1.0], (4, 1)))
    shapes = [planted, *(planted * (1.0 + step) for step in STEPS)]
    runs = OrganRuns(scene, poses, ("force_x_N", "force_y_N", "force_z_N"))
    loads, *others = runs([{"organ.young_kPa": PLANTED_KPA, key: shape} for shape in shapes])
    for step, other in zip(STEPS, others, strict=True):
        print(
            f"{key} changed by {step:.1%}: loads by "
            f"{1e3 * np.sqrt(np.mean((other - loads)[:, 2] ** 2)):.2f} mN rms"
        )
    times_s = 1e-3 * np.arange(len(loads))
    depths_mm = np.interp(times_s, TIMES_S, DEPTHS_MM)
    for seed in range(FIRST_SEED, FIRST_SEED + given.fits):
        noisy = loads + NOISE_N * np.random.default_rng(seed).standard_t(4, loads.shape)
        with TemporaryDirectory() as folder:
            path = Path(folder, "log.csv")
            columns = np.column_stack([times_s, 0.0 * depths_mm, 0.0 * depths_mm, depths_mm, noisy])
            head = "time_s,tool_x_mm,tool_y_mm,tool_z_mm,force_x_N,force_y_N,force_z_N"
            np.savetxt(path, columns, delimiter=",", header=head, comments="")
            fit = tissue.fit(scene, path, cores=1)
        table = fit.to_pandas()[["p05", "p50", "p95", "state"]]
        warned = any("do not agree" in each for each in fit.fitted.sentences)
        print(
            f"seed {seed}, planted {PLANTED_KPA:g} kPa and {planted:g}, "
            f"{'warned' if warned else 'not warned'}"
        )
        print(table.to_string(), flush=True)


if __name__ == "__main__":
    main()
