"""Folder of a fit to presses: constants for scenes, numbers, pictures and a report."""

from collections.abc import Mapping
from hashlib import sha256
from html import escape
from pathlib import Path

import numpy as np

from meshes.base.whole_file import package_version, write_columns
from tissue.fitting.fit_files import (
    FILES,
    FittedEntry,
    unit_of,
    write_fitted,
    write_results,
)
from tissue.fitting.probe_fit import ProbeFit
from tissue.show.figures.fit_pictures import draw_presses
from tissue.system.html import html_list
from tissue.system.owned_folder import OwnedFolder

__all__ = ["probe_verdicts", "write_probe_fit"]


def probe_verdicts(fit: ProbeFit) -> list[str]:
    """Return sentences on the constants of a fit to presses, doubts first."""
    found = [f"doubtful: {each}" for each in fit.doubts]
    for each in fit.constants:
        label, unit = unit_of(each.name)
        interval = f"{each.value:.3g} ({each.low:.3g} to {each.high:.3g}) {unit}".rstrip()
        found.append(f"{label}: {interval}")
    return found


def write_probe_fit(fit: ProbeFit, folder: Path, *, overwrite: bool) -> None:
    """Write the files of a fit to presses; see `tissue.fitting.fit_files.write_fit`."""
    digest = sha256(fit.path.read_bytes()).hexdigest()
    depths_mm = 1e3 * fit.table.depths_m
    forces = fit.table.forces_N
    with OwnedFolder(folder, "fit", FILES, overwrite=overwrite):
        source = f"fitted to {fit.path.name} ({digest[:12]}) as {fit.name} by law {fit.law}"
        entries = [
            FittedEntry(each.name, each.value, each.low, each.high, source, "M")
            for each in (fit.constants[at] for at in fit.of_material)
        ]
        remark = (
            f"Constants fitted by tissue {package_version()}; a scene takes them by: materials = "
            '"fitted.toml"',
            f"keys of the scene: {_settings(fit.scene_keys)}",
            "value: best fit; range: 5 and 95 % of resampled presses and error of the mesh.",
        )
        write_fitted(folder / "fitted.toml", entries, np.eye(len(entries)), remark=remark)
        draw_presses(depths_mm, forces, fit.force_N, folder / "measured.png", law=fit.law)
        low, middle, high = np.quantile(forces, [0.05, 0.5, 0.95], axis=0)
        columns = {"depth_mm": depths_mm, "median_N": middle, "p05_N": low, "p95_N": high}
        write_columns(folder / "loads.csv", columns | {"fitted_N": fit.force_N})
        above = (
            f"<p>{escape(fit.name)}, {fit.source} {escape(fit.path.name)}, law {fit.law}, tissue "
            f"{package_version()}.</p>"
            f"<h2>What the presses determine</h2>{html_list(probe_verdicts(fit))}"
        )
        pictures = {
            "Presses and fitted force": "measured.png",
            "Constants before and after, 90 % intervals": "constants.png",
        }
        write_results(fit, folder, _numbers(fit, digest), above, pictures)


def _settings(keys: Mapping[str, float]) -> str:
    return " ".join(f"--set {name}={value:.4g}" for name, value in keys.items()) or "none"


def _numbers(fit: ProbeFit, digest: str) -> dict[str, object]:
    """Return all results as a dictionary for programs."""
    return {
        "format": 1,
        "tissue": package_version(),
        "scene": fit.name,
        "measured": {"file": fit.path.name, "sha256": digest, "presses": len(fit.table.forces_N)},
        "law": fit.law,
        "doubts": list(fit.doubts),
        "constants": [
            {"name": one.name, "p05": one.low, "p50": one.value, "p95": one.high}
            for one in fit.constants
        ],
        "misfit": fit.misfit,
        "half_difference": {
            name: float(value) for name, value in zip(("p05", "p50", "p95"), fit.noise, strict=True)
        },
        "bias_N": fit.bias_N,
        "notes": list(fit.sentences),
    }
