"""Error of predicting silicone batch B from the elastic constants of batch A.

The constants come from cylinders. The error is given over the largest compression used in the fit.

`python tests/bench/bench_fit_silicone.py TRACES` takes the folder `anatomy/traces` of Dawood et al.
2026. The force is that of a column without friction, in closed form (the engine's cylinder agrees
with it within 2 %: `tests/verification/test_silicone.py`). The error is the root mean square over
tests of B. The scatter is the standard deviation over all ten tests. Both are relative to the mean
curve (L2).
"""

import sys
from pathlib import Path

import numpy as np
from harness import machine  # adds the fixtures to the path
from silicone_columns import fitted, linear_column, neo_hookean_column, ogden_column, yeoh_column

AREA_M2, HEIGHT_M = np.pi * 0.025**2, 0.03
AT = np.linspace(0.01, 0.6, 60)
LAWS = {
    "linear": linear_column,
    "neo-Hookean": neo_hookean_column,
    "Yeoh": yeoh_column,
    "Ogden": ogden_column,
}


def batch(folder: Path, mix: str, name: str) -> np.ndarray:
    """Stress [Pa] of each test at the compressions `AT`."""
    tables = [
        np.loadtxt(path, delimiter=",", skiprows=8)
        for path in sorted((folder / mix).glob(f"{mix}_{name}?.csv"))
    ]
    return np.array(
        [np.interp(AT, 1e-3 * t[:, 1] / HEIGHT_M, (t[:, 2] - t[0, 2]) / AREA_M2) for t in tables]
    )


def main(folder: Path) -> None:
    """Fit, predict and print."""
    print(machine())
    for mix in ("EF10_100T", "EF10_75T", "EF10_50T"):
        known, unknown = batch(folder, mix, "A"), batch(folder, mix, "B")
        both = np.concatenate([known, unknown])
        for most in (0.05, 0.1, 0.2, 0.3, 0.5, 0.6):
            used = most + 1e-9 >= AT
            size = np.linalg.norm(both.mean(axis=0)[used])
            scatter = (
                np.sqrt(np.sum((both - both.mean(axis=0))[:, used] ** 2) / (len(both) - 1)) / size
            )
            line = f"{mix:10} to {most:4.0%}   scatter {scatter:5.1%}"
            for law, column in LAWS.items():
                predicted = fitted(column, AT[used], known[:, used].mean(axis=0))
                error = (
                    float(
                        np.sqrt(np.mean(np.linalg.norm(unknown[:, used] - predicted, axis=1) ** 2))
                    )
                    / size
                )
                line += f"   {law} off {error:5.1%} = {error / scatter:.2f} scatters"
            print(line)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
