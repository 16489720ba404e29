"""Rows of a table and lines of a picture that are no settings: errors that no setting goes below."""

from math import nan

from tissue.evaluation.charts.measure import Measured, machine
from tissue.scene.scene import Scene

__all__ = ["BOUND_FAMILIES", "bound_row"]

BOUND_FAMILIES = ("law", "rounding")
"""Families of rows that are no settings. The error of a law is held to the neo-Hookean force, not to the reference."""


def bound_row(
    scene: Scene, name: str, family: str, error: float, *, leaves_out: str = "", median_us: float = nan,
    p99_us: float = nan, missed: int = 0, elements: int = 0, built_s: float = nan,
) -> Measured:  # fmt: skip
    """A row that is no setting; NaN for what it does not have, no tick for what only bounds an error."""
    return Measured(
        key="", scene=scene.name, setting=name, family=family, leaves_out=leaves_out, force_error=error,
        median_us=median_us, p99_us=p99_us, missed=missed, far_us=nan, engaged_mm2=nan, elements=elements, step_mm=nan,
        met=nan, built_s=built_s, machine=machine(),
    )  # fmt: skip
