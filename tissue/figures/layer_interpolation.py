"""Values of a grid's cells between their centres, layer by layer, for pictures without the cells' edges."""

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from tissue.fem.fields import FieldSeries

__all__ = ["interpolate_in_layers"]

CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


def interpolate_in_layers(
    series: FieldSeries, values: NDArray[np.floating], place_m: Array, layer: NDArray[np.integer]
) -> Array:
    """Values at places, trilinear between the centres of the cells of each place's layer.

    Cells of another layer or without a value do not count; where none of the eight around a place is left, the nearest
    cell of its layer does, or of any layer where it has none.

    Parameters
    ----------
    series
        Cubes of one edge on a lattice.
    values
        Value of each cell, shape (cells,), not a number where a cell is gone.
    place_m, layer
        The places [m], shape (k, 3), and the layer of each, shape (k,).
    """
    from scipy.spatial import cKDTree

    there = np.flatnonzero(np.isfinite(values))
    result = np.full(len(place_m), np.nan)
    if len(there) == 0:
        return result
    corners = series.nodes_m[series.cells[there]]
    centre, edge = corners.mean(axis=1), float(np.ptp(corners[0, :, 0]))
    low = centre.min(axis=0)
    lattice = np.rint((centre - low) / edge).astype(int)
    known = np.full(lattice.max(axis=0) + 3, -1)
    known[tuple((lattice + 1).T)] = there  # a border of cells that are not there
    scaled = (place_m - low) / edge + 1.0
    base = np.clip(np.floor(scaled).astype(int), 0, np.array(known.shape) - 2)
    part = np.clip(scaled - base, 0.0, 1.0)
    total, weights = np.zeros((2, len(place_m)))
    for corner in CORNERS:
        cell = known[tuple((base + corner).T)]
        weight = np.where(corner == 1, part, 1.0 - part).prod(axis=1)
        weight *= (cell >= 0) & (series.layer[cell] == layer)
        total += weight * np.where(weight > 0.0, values[cell], 0.0)
        weights += weight
    found = weights > 1e-9
    result[found] = total[found] / weights[found]
    for each in np.unique(layer[~found]):
        here = np.flatnonzero(~found & (layer == each))
        same = np.flatnonzero(series.layer[there] == each)
        rows = same if len(same) else np.arange(len(there))
        result[here] = values[there[rows[cKDTree(centre[rows]).query(place_m[here])[1]]]]
    return result
