"""Tables of what predictors were measured to do."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from meshes.base.whole_file import whole_file
from tissue.evaluation.training.evaluation import HORIZONS

if TYPE_CHECKING:
    from tissue.evaluation.charts.prediction import PredictorComparison

__all__ = ["FILES", "write_comparisons"]

FILES = ("prediction_tasks.png", "errors.csv", "cost.csv", "spectrum.csv", "training.csv", "slow_model.csv")
HEADS = {
    "errors.csv": "scene,predictor,horizon_ms,runs,error,low,high",
    "cost.csv": "scene,predictor,median_us,p99_us",
    "spectrum.csv": "scene,real,imaginary,size",
    "training.csv": "scene,runs,error,low,high",
    "slow_model.csv": "scene,predictor,error,low,high,cost_us",
}


def write_comparisons(found: "Sequence[PredictorComparison]", folder: Path) -> None:
    """Write all tables; errors are shares of the force, low and high their 95 % interval."""
    rows: dict[str, list[str]] = {name: [head] for name, head in HEADS.items()}
    for each in found:
        for kind, errors in each.errors.items():
            for horizon in HORIZONS:
                at = each.at(kind, horizon)
                rows["errors.csv"].append(_line(each.scene, kind, horizon, len(errors), at.mean, at.low, at.high))
        for kind, (median, p99) in each.cost_us.items():
            rows["cost.csv"].append(_line(each.scene, kind, median, p99))
        for value in each.eigenvalues.tolist():
            rows["spectrum.csv"].append(_line(each.scene, value.real, value.imag, abs(value)))
        for size, at in each.sizes.items():
            rows["training.csv"].append(_line(each.scene, size, at.mean, at.low, at.high))
        for kind, (at, cost_us) in each.slow.items():
            rows["slow_model.csv"].append(_line(each.scene, kind, at.mean, at.low, at.high, cost_us))
    for name, lines in rows.items():
        with whole_file(folder / name) as temporary:
            temporary.write_text("\n".join(lines) + "\n", "utf-8")


def _line(*cells: object) -> str:
    return ",".join(cell if isinstance(cell, str) else repr(cell) for cell in cells)
