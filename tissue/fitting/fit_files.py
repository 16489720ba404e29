"""Output folder of a fit: constants for scenes, numbers, pictures, and a report in one file."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from hashlib import sha256
from html import escape
from pathlib import Path

import numpy as np
import tomli_w

from meshes.base.arrays import Array
from meshes.base.whole_file import package_version, write_columns, write_text
from tissue.fitting.bands.sample import toml_tables
from tissue.fitting.pictures import draw_constants
from tissue.fitting.result import Fitted
from tissue.materials.constants import Constant
from tissue.system.html import html_list, html_page, html_picture
from tissue.system.owned_folder import OwnedFolder

DIGITS = 9
"""Significant digits of written numbers. The rounding is far smaller than any interval."""


def write_fitted(
    path: Path,
    entries: Mapping[str, Constant],
    correlation: Array,
    *,
    fixed: Mapping[str, Constant] | None = None,
    remark: Sequence[str] = (),
) -> None:
    """Write fitted constants with their correlation.

    Parameters
    ----------
    path
        File to write.
    entries
        The n constants, keyed by name: ``TABLE.MATERIAL.NAME``.
    correlation
        Correlation matrix, shape (n, n), of the standard normal numbers to which the constants are
        transformed, see `tissue.materials.constants.Prior`.
    fixed
        Other constants, without a range, on which the fitted constants depend.
    remark
        Lines of comment at the top.
    """
    rounded = {
        name: replace(
            one, value=_rounded(one.value), low=_rounded(one.low), high=_rounded(one.high)
        )
        for name, one in {**entries, **(fixed or {})}.items()
    }
    content: dict[str, object] = dict(toml_tables(rounded))
    # rounding may leave the matrix slightly unsymmetric; a single constant has no correlation
    if len(entries) > 1:
        matrix = 0.5 * (correlation + correlation.T)
        np.fill_diagonal(matrix, 1.0)
        content["correlation"] = {
            "names": [*entries],
            "matrix": [[round(float(value), DIGITS) for value in row] for row in matrix],
        }
    lines = "".join(f"# {line}\n" for line in remark)
    write_text(path, f"{lines}\n{tomli_w.dumps(content)}")


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


FILES = (
    "fitted.toml",
    "report.html",
    "fit.json",
    "loads.csv",
    "measured.png",
    "constants.png",
    # written by earlier versions
    "residuals.png",
)
PICTURES = {
    "Constants before and after, 90 % intervals": "constants.png",
    "Measured and fitted": "measured.png",
}
"""File name of each picture in a report, keyed by the title of the picture."""


def write_fit(fit: Fitted, folder: Path, *, overwrite: bool) -> None:
    """Write the files of a fit.

    Parameters
    ----------
    fit
        Fit to write.
    folder
        Output folder for `FILES`.
    overwrite
        True to replace another fit in the folder.

    Raises
    ------
    InputError
        If the folder is a file, or holds another fit.
    """
    digest = sha256(fit.path.read_bytes()).hexdigest()
    with OwnedFolder(folder, "fit", FILES, overwrite=overwrite):
        # Keys of a scene are no constants of a material: a scene refuses a file of constants
        # without any constant.
        if fit.of_material:
            _write_constants(fit, folder / "fitted.toml", digest)
        write_columns(folder / "loads.csv", fit.columns)
        fit.draw(folder / "measured.png")
        draw_constants(fit.constants, folder / "constants.png", source=fit.source)
        numbers = _numbers(fit, digest) | fit.numbers
        write_text(folder / "fit.json", json.dumps(numbers, indent=1) + "\n")
        write_text(folder / "report.html", html_page(f"Fit of {fit.name}", _report(fit, folder)))


def _write_constants(fit: Fitted, path: Path, digest: str) -> None:
    """Write the fitted material constants and their correlation to a file that a scene can use."""
    reservations = {
        "at its prior": ", which does not narrow the cited range",
        "doubtful": ", doubtful: it contradicts the cited range or the clocks of the log",
    }
    entries = {}
    for at in fit.of_material:
        each = fit.constants[at]
        source = f"fitted to {fit.path.name} ({digest[:12]}) as {fit.name}"
        source += reservations.get(each.state, "")
        # a single log of one specimen gives medium confidence at best
        confidence = "M" if each.state in fit.findings else "L"
        entries[each.name] = Constant(each.value, each.low, each.high, source, confidence)
    text = "the density at which the fitted coefficients are stated"
    fixed = {name: Constant(value, value, value, text, "H") for name, value in fit.fixed.items()}
    remark = (
        f"Constants fitted by tissue {package_version()}; a scene takes them by: materials = "
        f'"{path.name}"',
        f"keys of the scene: {_key_options(fit) or 'none'}",
        fit.meaning,
    )
    write_fitted(path, entries, fit.correlation, fixed=fixed, remark=remark)


def _key_options(fit: Fitted) -> str:
    """Return the options of `tissue run` that set the fitted keys of the scene."""
    return " ".join(f"--set {name}={value:.4g}" for name, value in fit.scene_keys.items())


def _numbers(fit: Fitted, digest: str) -> dict[str, object]:
    """Return the machine-readable results that every kind of fit has."""
    return {
        "format": 1,
        "tissue": package_version(),
        "scene": fit.name,
        "measured": {"file": fit.path.name, "sha256": digest} | fit.size,
        "doubts": list(fit.doubts),
        "constants": [
            {
                "name": one.name,
                "p05": one.low,
                "p50": one.value,
                "p95": one.high,
                "contraction": one.contraction,
                "state": one.state,
                "prior": [one.prior.low, one.prior.value, one.prior.high],
                "standard_deviations_from_prior": one.z[1],
            }
            for one in fit.constants
        ],
        "notes": list(fit.sentences),
    }


def _report(fit: Fitted, folder: Path) -> str:
    """Return the HTML content of the report, including the pictures that lie in `folder`."""
    parts = [
        f"<p>{escape(fit.name)}, {fit.source} {escape(fit.path.name)}, tissue {package_version()}."
    ]
    if fit.of_material:
        parts.append(' A scene takes the constants by <code>materials = "fitted.toml"</code>.')
    if fit.scene_keys:
        parts.append(f" Set the fitted keys of the scene by <code>{_key_options(fit)}</code>.")
    parts.append(f"</p><h2>What the {fit.source} determines</h2>{html_list(fit.verdicts)}")
    for title, name in PICTURES.items():
        parts.append(f"<h2>{title}</h2>{html_picture(title, (folder / name).read_bytes())}")
    for title, rows in fit.tables.items():
        lines = ["".join(f"<th>{escape(name)}</th>" for name in rows[0])]
        lines += ["".join(f"<td>{escape(cell)}</td>" for cell in row.values()) for row in rows]
        table = "".join(f"<tr>{line}</tr>" for line in lines)
        parts.append(f"<h2>{title}</h2><table>{table}</table>")
    return f"{''.join(parts)}<h2>Notes</h2>{html_list(fit.sentences)}"
