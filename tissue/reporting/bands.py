"""The band of a run as HTML: intervals of its figures, and its pictures."""

from base64 import b64encode
from collections.abc import Callable
from typing import Any

from tissue.simulation.run_folder import SavedRun
from tissue.uncertainty.figures import band_lines

__all__ = ["band_section"]

ROWS = (
    ("peak force", "force_N", "peak", "N"),
    ("mean force in contact", "force_N", "mean_in_contact", "N"),
    ("peak torque", "torque_Nm", "peak", "N m"),
    ("mean torque in contact", "torque_Nm", "mean_in_contact", "N m"),
)
ENDS = ("p25", "p75"), ("p05", "p95")
"""Ends of the bands of 50 and 90 %."""
PICTURES = {"png": "image/png", "svg": "image/svg+xml"}
"""Formats that a page shows, with their types."""


def band_section(saved: SavedRun, text: Callable[[str], str]) -> str:
    """Return heading, table and pictures of the band of a run, or nothing where the run has no band.

    `text` makes HTML of a plain text.
    """
    band: dict[str, Any] | None = saved.summary.get("band")
    if band is None or not saved.complete:
        return ""
    rows = []
    for label, outer, inner, unit in ROWS:
        at, value = band[outer][inner], saved.summary[outer].get(inner, 0.0)
        cells = [f"{value:.3g}", f"{at['p50']:.3g}", *(f"{at[low]:.3g} to {at[high]:.3g}" for low, high in ENDS)]
        rows.append(f"<tr><td>{label} / {unit}</td>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    head = "".join(f"<th>{name}</th>" for name in ("figure", "this run", "median", "50 %", "90 %"))
    sentence = f"{len(band['constants'])} constants in their ranges. The error of the model itself is not in it."
    lines = "".join(f"<li>{text(line)}</li>" for line in band_lines(band))
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
    return f"<h2>Bands</h2><p>{sentence}</p>{table}<ul>{lines}</ul>{_pictures(saved)}"


def _pictures(saved: SavedRun) -> str:
    found = []
    for name, words in (("band", "loads over time with their bands"), ("band_sobol", "which constant matters")):
        for ending, kind in PICTURES.items():
            path = saved.path / "pictures" / f"{name}.{ending}"
            if path.is_file():
                data = b64encode(path.read_bytes()).decode()
                found.append(f'<img src="data:{kind};base64,{data}" alt="{words}">')
    return "".join(found)
