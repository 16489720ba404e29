"""Folder of a fit: constants for scenes, numbers, pictures, and a report as one file."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from hashlib import sha256
from html import escape
from pathlib import Path

import numpy as np
import tomli_w

from meshes.base.arrays import Array
from meshes.base.whole_file import package_version, write_columns, write_text
from tissue.fitting.bands.sample import toml_tables
from tissue.fitting.fit import ConstantFit, SceneFit, TableFit
from tissue.fitting.laws import LawMisfit, law_sentences
from tissue.fitting.probe_fit import ProbeFit
from tissue.materials.constants import Constant
from tissue.show.figures.fit_pictures import (
    FittedConstant,
    draw_constants,
    draw_measured,
    draw_presses,
    draw_table,
)
from tissue.system.html import html_list, html_page, html_picture
from tissue.system.owned_folder import OwnedFolder

__all__ = ["unit_of", "verdicts", "write_fit", "write_fitted"]


DIGITS = 9
"""Significant digits of a number. The rounding is far smaller than any interval."""


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
        The n constants by their names, ``TABLE.MATERIAL.NAME``.
    correlation
        Correlation of the standard normal numbers of these constants, shape (n, n), see
        `tissue.materials.constants.Prior`.
    fixed
        Constants that have no range, and on which the fitted constants depend.
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
    "residuals.png",
    "constants.png",
)
UNITS = ("N_mm2", "N_mm", "kPa", "um", "s")
SHOWN_GAINS = SHOWN_COMBINATIONS = 5
NATS = 0.1
"""Information gain below which another log is not recommended [nats].

For a single constant, a gain of 0.1 nats narrows the interval by 10 %.
"""


def write_fit(fit: SceneFit | ProbeFit, folder: Path, *, overwrite: bool) -> None:
    """Write the files of a fit.

    Parameters
    ----------
    fit
        Fit to write.
    folder
        Output folder for `FILES`.
    overwrite
        Replace another fit in the folder.

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
        if isinstance(fit, ProbeFit):
            _write_presses(fit, folder)
        elif isinstance(fit, TableFit):
            _write_table_loads(fit, folder)
        else:
            _write_log_loads(fit, folder)
        shown = [shown_constant(each) for each in fit.constants]
        draw_constants(shown, folder / "constants.png", source=fit.source)
        write_text(folder / "fit.json", json.dumps(_numbers(fit, digest), indent=1) + "\n")
        write_text(folder / "report.html", html_page(f"Fit of {fit.name}", _report(fit, folder)))


def _write_presses(fit: ProbeFit, folder: Path) -> None:
    """Write forces as a function of the depth, as numbers and as a picture."""
    depths_mm = 1e3 * fit.table.depths_m
    forces = fit.table.forces_N
    draw_presses(depths_mm, forces, fit.force_N, folder / "measured.png", law=fit.law)
    low, middle, high = np.quantile(forces, [0.05, 0.5, 0.95], axis=0)
    columns = {"depth_mm": depths_mm, "median_N": middle, "p05_N": low, "p95_N": high}
    write_columns(folder / "loads.csv", columns | {"fitted_N": fit.force_N})


def _write_log_loads(fit: SceneFit, folder: Path) -> None:
    """Write loads as a function of time, as numbers and as pictures."""
    posterior = fit.posterior
    log = posterior.target.log
    simulated = posterior.simulated
    columns = {"time_s": log.times_s}
    for at, name in enumerate(log.channels):
        columns[f"measured_{name}"] = log.values[:, at]
        columns[f"simulated_{name}"] = simulated[:, at]
    draw_measured(log.times_s, log.values, simulated, log.channels, folder / "measured.png")
    write_columns(folder / "loads.csv", columns)


def _write_table_loads(fit: TableFit, folder: Path) -> None:
    """Write loads as a function of the feed per turn, as numbers and as a picture."""
    table = fit.table
    simulated = fit.posterior.simulated * table.units
    feeds_mm = 1e3 * table.feeds_per_turn_m
    columns = {"feed_mm_per_turn": feeds_mm}
    for at, (name, channel) in enumerate(zip(table.names, table.channels, strict=True)):
        unit = channel.rpartition("_")[2]
        load = f"{name.partition('_')[0]}_{unit}"
        columns[f"measured_{load}"] = table.loads[:, at]
        columns[f"simulated_{load}"] = simulated[:, at]
    draw_table(
        feeds_mm, table.loads, simulated, table.scatter, table.channels, folder / "measured.png"
    )
    write_columns(folder / "loads.csv", columns)


def unit_of(name: str) -> tuple[str, str]:
    """Split the name of a constant into words without the unit, and the unit in its usual form."""
    last = name.rpartition(".")[2]
    unit = next((each for each in UNITS if last.endswith(f"_{each}")), "")
    words = (
        name.removesuffix(f"_{unit}").removeprefix("cutting.").replace(".", " ").replace("_", " ")
    )
    marks = {"N_mm2": "N/mm²", "N_mm": "N/mm", "um": "µm"}
    return words, marks.get(unit, unit)


def _write_constants(fit: SceneFit | ProbeFit, path: Path, digest: str) -> None:
    """Write the file for scenes: constants of the material with their correlation."""
    source = f"fitted to {fit.path.name} ({digest[:12]}) as {fit.name}"
    reservations = {
        "at its prior": ", which does not narrow the cited range",
        "doubtful": ", doubtful: it contradicts the cited range or the clocks of the log",
    }
    if isinstance(fit, ProbeFit):
        source += f" by law {fit.law}"
    entries = {}
    for at in fit.of_material:
        each = fit.constants[at]
        text = source + reservations.get(each.state, "")
        # a single log of one specimen gives medium confidence at best
        confidence = "M" if isinstance(fit, ProbeFit) or each.state == "determined" else "L"
        entries[each.name] = Constant(each.value, each.low, each.high, text, confidence)
    text = "the density at which the fitted coefficients are stated"
    fixed = {name: Constant(value, value, value, text, "H") for name, value in fit.fixed.items()}
    remark = (
        f"Constants fitted by tissue {package_version()}; a scene takes them by: materials = "
        f'"{path.name}"',
        f"keys of the scene: {_key_options(fit) or 'none'}",
        fit.meaning,
    )
    write_fitted(path, entries, fit.correlation, fixed=fixed, remark=remark)


def _key_options(fit: SceneFit | ProbeFit) -> str:
    """Return the options of `tissue run` that set the fitted keys of the scene."""
    return " ".join(f"--set {name}={value:.4g}" for name, value in fit.scene_keys.items())


def _use_of_result(fit: SceneFit | ProbeFit) -> str:
    """Return the sentences of a report on the use of the fitted constants in a scene, as HTML."""
    found = []
    if fit.of_material:
        found.append('A scene takes the constants by <code>materials = "fitted.toml"</code>.')
    if fit.scene_keys:
        found.append(f"Set the fitted keys of the scene by <code>{_key_options(fit)}</code>.")
    return " ".join(found)


def shown_constant(each: ConstantFit) -> FittedConstant:
    """Return a constant in the form that the pictures use."""
    label, unit = unit_of(each.name)
    if each.state == "doubtful":
        label = f"{label} (doubtful)"
    low, middle, high, lowest, highest = each.z
    return FittedConstant(
        label,
        unit,
        (each.prior.low, each.prior.value, each.prior.high),
        (each.low, each.value, each.high),
        (low, middle, high),
        (lowest, highest),
        each.state != "at its prior",
    )


def _numbers(fit: SceneFit | ProbeFit, digest: str) -> dict[str, object]:
    """Return all results as a dictionary for programs."""
    found: dict[str, object] = {
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
    if isinstance(fit, ProbeFit):
        half = dict(zip(("p05", "p50", "p95"), fit.noise.tolist(), strict=True))
        numbers = {"law": fit.law, "misfit": fit.misfit, "bias_N": fit.bias_N}
        return found | numbers | {"half_difference": half}
    found["converged"] = fit.posterior.converged
    found["combinations"] = [
        {
            "weights": one.weights,
            "p05": one.low,
            "p50": one.value,
            "p95": one.high,
            "contraction": one.contraction,
        }
        for one in fit.identified.combinations
    ]
    found["next"] = [asdict(one) for one in fit.gains]
    if isinstance(fit, TableFit):
        return found | {"laws": [asdict(one) for one in fit.laws]}
    each = fit.posterior.nuisances
    low, high = fit.posterior.offset_interval_s
    return found | {
        "offset_s": [low, each.offset_s, high],
        "channels": list(fit.posterior.target.log.channels),
        "bias": each.bias.tolist(),
        "noise_scale": each.scale.tolist(),
        "noise_correlation": each.correlation.tolist(),
        "noise_freedom": each.freedom.tolist(),
    }


def verdicts(fit: SceneFit | ProbeFit) -> list[str]:
    """Return sentences on the results of the fit.

    The sentences are about contradictions to the priors, determined constants, combinations,
    constants that stay at their priors, and the log to measure next, in this order.
    """
    found = [f"doubtful: {each}" for each in fit.doubts]
    for each in fit.constants:
        if isinstance(fit, ProbeFit) or each.state == "determined":
            label, unit = unit_of(each.name)
            interval = f"{each.value:.3g} ({each.low:.3g} to {each.high:.3g}) {unit}"
            found.append(f"{label}: {interval}".rstrip())
    if isinstance(fit, ProbeFit):
        return found
    for combined in fit.identified.combinations[:SHOWN_COMBINATIONS]:
        # A constant whose prior has the median 0 has no weight over that median.
        weights = {name: weight for name, weight in combined.weights.items() if weight != 0.0}
        terms = [f"{weight:.2g} {unit_of(name)[0]}" for name, weight in weights.items()]
        found.append(
            "known better together, each over the median of its prior: "
            f"{' + '.join(terms).replace('+ -', '- ')} = {combined.value:.4g} "
            f"({combined.low:.4g} to {combined.high:.4g})"
        )
    if at_prior := [unit_of(name)[0] for name in fit.identified.at_prior]:
        found.append(
            f"not narrowed by this {fit.source}, left at the cited range: {', '.join(at_prior)}"
        )
    if fit.gains and fit.gains[0].nats > NATS:
        best = fit.gains[0]
        found.append(
            f"to measure next: {best.label}, which adds {best.nats:.2g} nats and brings the "
            f"interval of {unit_of(best.widest)[0]} to {best.shrinks_to:.0%} of that now"
        )
    return found


PICTURES = {
    "Constants before and after, 90 % intervals": "constants.png",
    "Measured and simulated": "measured.png",
}
"""Pictures of a report by their titles."""


def _report(fit: SceneFit | ProbeFit, folder: Path) -> str:
    """Return the content of the report, with the pictures in a folder."""
    parts = [
        f"<p>{escape(fit.name)}, {fit.source} {escape(fit.path.name)}, tissue "
        f"{package_version()}. {_use_of_result(fit)}</p>"
        f"<h2>What the {fit.source} determines</h2>{html_list(verdicts(fit))}"
    ]
    if isinstance(fit, TableFit):
        parts.append(_law_table(fit.laws))
    for title, name in PICTURES.items():
        if (folder / name).exists():
            picture = html_picture(title, (folder / name).read_bytes())
            parts.append(f"<h2>{title}</h2>{picture}")
    if isinstance(fit, SceneFit):
        parts.append(_next_logs(fit))
    return f"{''.join(parts)}<h2>Notes</h2>{html_list(fit.sentences)}"


def _next_logs(fit: SceneFit) -> str:
    """Return the section of a report on the log to measure next; empty if no logs are known."""
    if not fit.gains:
        return ""
    rows = "".join(
        f"<tr><td>{escape(one.label)}</td><td>{one.nats:.2g}</td><td>{one.shrinks_to:.0%}</td></tr>"
        for one in fit.gains[:SHOWN_GAINS]
    )
    widest = escape(unit_of(fit.gains[0].widest)[0])
    return (
        "<h2>What to measure next</h2><table><tr><th>log of a second</th>"
        "<th>expected information / nats</th>"
        f"<th>interval of {widest}, of that now</th></tr>{rows}</table>"
    )


def _law_table(laws: Sequence[LawMisfit]) -> str:
    """Return the section of a report that compares cutting laws."""

    def shown(value: float | None, form: str) -> str:
        return "" if value is None else format(value, form)

    rows = "".join(
        f"<tr><td>{escape(each.name)}</td><td>{each.constants}</td>"
        f"<td>{shown(each.chi_square, '.3g')} ({each.freedom})</td><td>{shown(each.p, '.2g')}</td>"
        f"<td>{shown(each.aic, '.1f')}</td><td>{shown(each.left_out, '.1%')}</td>"
        f"<td>{shown(each.cited_chi_square, '.3g')}</td><td>{shown(each.cited_p, '.2g')}</td></tr>"
        for each in laws
    )
    return (
        "<h2>Which law the table rejects</h2>"
        f"{''.join(f'<p>{escape(line)}.</p>' for line in law_sentences(laws))}"
        "<table><tr><th>law</th><th>constants</th><th>chi-square (degrees of freedom)</th>"
        "<th>p</th><th>AIC</th><th>rows predicted from the others, off by</th>"
        f"<th>chi-square with cited ranges</th><th>p</th></tr>{rows}</table>"
        "<p>The last two columns take the cited ranges of the coefficients as priors. The other "
        "columns are a maximum-likelihood fit with free coefficients.</p>"
    )
