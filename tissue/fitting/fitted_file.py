"""The file of fitted constants that a scene names: ``materials = "fitted.toml"``."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tomli_w

from meshes.base.arrays import Array
from meshes.base.whole_file import whole_file

__all__ = ["FittedEntry", "write_fitted"]

DIGITS = 9
"""Significant digits of a number: rounding is far below any interval."""


@dataclass(frozen=True)
class FittedEntry:
    """Constant after a fit.

    Attributes
    ----------
    name
        ``TABLE.MATERIAL.NAME``.
    value, low, high
        Median, 5 and 95 % of the posterior, in the constant's unit.
    source, confidence
        Source of the numbers, and their confidence: H, M or L.
    """

    name: str
    value: float
    low: float
    high: float
    source: str
    confidence: str


def write_fitted(
    path: Path,
    entries: Sequence[FittedEntry],
    correlation: Array,
    *,
    fixed: Sequence[FittedEntry] = (),
    remark: Sequence[str],
) -> None:
    """Write fitted constants with their correlation.

    Parameters
    ----------
    path
        File to write.
    entries
        The n constants.
    correlation
        Correlation of their standard normal numbers, shape (n, n), see
        `tissue.materials.constants.Prior`.
    fixed
        Constants without a range that the others depend on.
    remark
        Lines of comment at the top.
    """
    tables: dict[str, dict[str, dict[str, Mapping[str, object]]]] = {}
    for entry in (*entries, *fixed):
        table, material, name = entry.name.split(".", 2)
        tables.setdefault(table, {}).setdefault(material, {})[name] = {
            "value": _rounded(entry.value),
            "range": [_rounded(entry.low), _rounded(entry.high)],
            "source": entry.source,
            "confidence": entry.confidence,
        }
    content: dict[str, object] = dict(tables)
    if len(entries) > 1:
        matrix = 0.5 * (correlation + correlation.T)
        np.fill_diagonal(matrix, 1.0)
        content["correlation"] = {
            "names": [entry.name for entry in entries],
            "matrix": [[round(float(value), DIGITS) for value in row] for row in matrix],
        }
    lines = "".join(f"# {line}\n" for line in remark)
    with whole_file(path) as temporary:
        temporary.write_text(f"{lines}\n{tomli_w.dumps(content)}", "utf-8")


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
