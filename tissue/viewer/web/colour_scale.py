"""The scale of colours as a page draws it, in place of that in the picture."""

from math import floor, log10
from typing import Any

import numpy as np

from tissue.viewer.plotter import Plotter

__all__ = ["taken_scale"]

STOPS, MARKS = 24, 5
"""Colours and labels along a scale."""


def taken_scale(plotter: Plotter) -> dict[str, Any] | None:
    """Hide a plotter's scale of colours, and give its title, colours as ``#rrggbb`` from low to high, and labels.

    None where it has none.
    """
    from matplotlib.colors import to_hex

    found = None
    for title, bar in plotter.scalar_bars.items():
        bar.SetVisibility(False)
        table = bar.GetLookupTable()
        low, high = table.GetTableRange()
        spaced = np.geomspace if table.UsingLogScale() else np.linspace
        colours = []
        for value in spaced(low, high, STOPS).tolist():
            colour = [0.0, 0.0, 0.0]
            table.GetColor(value, colour)
            colours.append(to_hex((colour[0], colour[1], colour[2])))
        digits = max(2 - floor(log10(max(high - low, 1e-12))), 0)
        kind = ".2g" if table.UsingLogScale() or digits > 4 else f".{digits}f"
        labels = [format(value, kind) for value in spaced(low, high, MARKS).tolist()]
        found = {"title": title.split("\n")[0], "colours": colours, "labels": labels}
    return found
