"""Smooth boundaries and sections of meshes, with interpolated fields, for pictures."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Floats, Singles
from tissue.fem.fields import FieldSeries
from tissue.simulation.saved_fields import field_values

if TYPE_CHECKING:
    import pyvista

__all__ = [
    "SHOWN",
    "at_nodes",
    "drawn_surface",
    "inclusions",
    "interpolate_in_layers",
    "section_cap",
    "with_normals",
]

SHOWN = "shown"
"""Name of the point array with the values that are drawn."""
SHARP_DEG = 40.0
"""Angle above which an edge is drawn sharp: edges of a block, but not edges between facets."""
LEVELS = 2
"""Number of times that each triangle of the boundary is divided into four.

Sixteen triangles instead of one look smooth at the size of a picture.
"""
CAP_EDGE = 0.012
MOST_PASSES = 10
"""Longest edge of the triangles of a section, relative to the diagonal of the organ, and largest
number of divisions.

In a picture, the longest edge is about ten pixels long.
"""


INWARD = 5e-3
"""Share of the distance to the middle of a cell by which a boundary point is moved inside.

Because of rounding, a point on the boundary itself may count as outside.
"""


def drawn_surface(mesh: "pyvista.DataSet", values: Singles) -> "pyvista.PolyData":
    """Return the boundary of a mesh as a smooth surface, curved between the nodes (Vlachos 2001).

    The surface is perpendicular to the normals at the nodes. Sharp edges stay sharp.

    Parameters
    ----------
    mesh
        Mesh of three-dimensional cells [mm].
    values
        Values at the nodes, shape (nodes,) or (nodes, k). They are returned as the point array
        `SHOWN`.
    """
    body = mesh.copy(deep=False)
    body.clear_data()
    body.point_data[SHOWN] = values
    surface = with_normals(body.extract_surface(algorithm="dataset_surface").triangulate())
    for _ in range(LEVELS):
        surface = _divided(surface)
    return surface


def _divided(surface: "pyvista.PolyData") -> "pyvista.PolyData":
    """Divide each triangle into four.

    New points lie on curves that are perpendicular to the normals at both ends of an edge. The two
    sides of a sharp edge have separate points. The two new points on such an edge use the mean of
    the curves, so the sides stay together.
    """
    import pyvista

    points, normals = (
        np.asarray(each, dtype=np.float64)
        for each in (surface.points, surface.point_data["Normals"])
    )
    faces = surface.regular_faces
    values = np.asarray(surface.point_data[SHOWN])
    edges, of_face = np.unique(
        np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1),
        axis=0,
        return_inverse=True,
    )
    first, second = edges.T
    along = points[second] - points[first]
    bent = np.zeros_like(along)
    # the middle of a cubic whose end tangents are at right angles to the normals: an eighth of the
    # slope at each end
    for end, sign in ((first, -0.125), (second, 0.125)):
        bent += sign * np.einsum("ij,ij->i", along, normals[end])[:, None] * normals[end]
    place = np.unique(points, axis=0, return_inverse=True)[1].reshape(-1)
    same = np.unique(np.sort(place[edges], axis=1), axis=0, return_inverse=True)[1].reshape(-1)
    copies = np.bincount(same)
    bent = np.column_stack([np.bincount(same, bent[:, c]) / copies for c in range(3)])[same]
    middle = 0.5 * (points[first] + points[second]) + bent
    (a, b, c) = faces.T
    (ab, bc, ca) = (len(points) + of_face.reshape(-1, 3)).T
    quarters = (
        np.stack([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]])
        .transpose(2, 0, 1)
        .reshape(-1, 3)
    )
    fine = pyvista.PolyData.from_regular_faces(np.vstack([points, middle]), quarters)
    fine.point_data[SHOWN] = np.concatenate([values, 0.5 * (values[first] + values[second])])
    return fine.compute_normals(cell_normals=False, split_vertices=False, consistent_normals=False)


def with_normals(surface: "pyvista.PolyData") -> "pyvista.PolyData":
    """Return a surface with normals at its points.

    The two sides of a sharp edge have separate points and normals.
    """
    return surface.compute_normals(
        cell_normals=False, split_vertices=True, feature_angle=SHARP_DEG, consistent_normals=False
    )


def section_cap(
    mesh: "pyvista.DataSet",
    surface: "pyvista.PolyData",
    name: str,
    *,
    place_mm: Array,
    normal: Array,
) -> "pyvista.PolyData":
    """Return the plane section of a mesh inside its drawn boundary, with values of a field.

    The values are the point array `SHOWN`.

    Before the interpolation, cell values are averaged at the nodes, separately for each layer. The
    edge of an inclusion therefore stays sharp.
    """
    import pyvista
    from vtkmodules.vtkFiltersGeneral import vtkContourTriangulator

    filler = vtkContourTriangulator()
    filler.SetInputData(surface.clean().slice(normal=tuple(normal), origin=tuple(place_mm)))
    filler.Update()
    cap: pyvista.PolyData = pyvista.wrap(filler.GetOutput())
    cap.clear_data()
    # the plane misses the mesh
    if not cap.n_cells:
        return cap
    cap = cap.subdivide_adaptive(max_edge_len=CAP_EDGE * surface.length, max_n_passes=MOST_PASSES)
    places = np.asarray(cap.points, dtype=np.float64)
    layers = np.asarray(mesh.cell_data["layer"])
    # a single layer needs no search for the cell of each place
    several = layers.min() < layers.max()
    layer = layers[mesh.find_closest_cell(places)] if several else np.full(len(places), layers[0])
    values = np.zeros(len(places))
    for index in np.unique(layer):
        there = layer == index
        part = mesh.extract_cells(np.flatnonzero(layers == index).tolist())
        at = at_nodes(part, name)
        part.clear_data()
        part.point_data[SHOWN] = at
        values[there] = _sampled(part, places[there])
    cap.point_data[SHOWN] = values
    return cap


def at_nodes(mesh: "pyvista.DataSet", name: str) -> Singles:
    """Return the values of a field at the nodes.

    If the field is defined in the cells, its values are averaged over the cells around each node.
    """
    values = field_values(mesh if name in mesh.point_data else mesh.cell_data_to_point_data(), name)
    assert values is not None
    return np.asarray(values)


def _sampled(mesh: "pyvista.DataSet", places: Array) -> Array:
    """Interpolate `SHOWN` in a mesh.

    Places outside the mesh get the value at the nearest place inside.

    Such places exist because the drawn boundary is curved outwards between the nodes.
    """
    import pyvista

    found = pyvista.PolyData(places).sample(mesh)
    values = np.array(found.point_data[SHOWN], dtype=np.float64)
    outside = np.flatnonzero(np.asarray(found.point_data["vtkValidPointMask"]) == 0)
    if len(outside):
        nearest: Any = mesh.find_closest_cell(places[outside], return_closest_point=True)
        cell, closest = nearest
        inside = closest + INWARD * (mesh.cell_centers().points[cell] - closest)
        values[outside] = pyvista.PolyData(inside).sample(mesh).point_data[SHOWN]
    return values


def inclusions(corners: Floats, layer: NDArray[np.integer]) -> NDArray[np.intp]:
    """Return the indices of the cells of an inclusion, such as a nodule.

    An inclusion is a layer whose bounding box lies inside the bounding box of the mesh. Of several
    inclusions, the one with the fewest cells is returned. Without an inclusion, the result is
    empty.

    Parameters
    ----------
    corners
        Positions of the corners of each cell, shape (cells, corners, 3).
    layer
        Layer of each cell, shape (cells,).
    """
    low = corners.min(axis=1)
    high = corners.max(axis=1)
    found = []
    for index in np.unique(layer):
        here = layer == index
        if (low[here].min(axis=0) > low.min(axis=0)).all() and (
            high[here].max(axis=0) < high.max(axis=0)
        ).all():
            found.append(np.flatnonzero(here))
    return min(found, key=len, default=np.zeros(0, dtype=np.intp))


def interpolate_in_layers(
    series: FieldSeries, values: Floats, place_m: Array, layer: NDArray[np.integer]
) -> Array:
    """Interpolate cell values trilinearly at places, separately in each layer.

    For each place, only cells that have a value and belong to the layer of this place are used. If
    none of the eight cells around the place can be used, the nearest cell of the layer is used. If
    the layer has no cell, the nearest cell of any layer is used.

    Parameters
    ----------
    series
        Cubic cells of equal size on a lattice.
    values
        Value of each cell, shape (cells,), NaN for removed cells.
    place_m, layer
        Places [m], shape (k, 3), and layer of each place, shape (k,).
    """
    from scipy.ndimage import map_coordinates
    from scipy.spatial import cKDTree

    there = np.flatnonzero(np.isfinite(values))
    result = np.full(len(place_m), np.nan)
    if len(there) == 0:
        return result
    corners = series.nodes_m[series.cells[there]]
    centre = corners.mean(axis=1)
    edge = float(np.ptp(corners[0, :, 0]))
    low = centre.min(axis=0)
    lattice = np.rint((centre - low) / edge).astype(int)
    for index in np.unique(layer):
        here = np.flatnonzero(layer == index)
        same = np.flatnonzero(series.layer[there] == index)
        # Normalised convolution: interpolated sum of values, divided by the interpolated number of
        # cells.
        total, weight = np.zeros((2, *(lattice.max(axis=0) + 1)))
        total[tuple(lattice[same].T)] = values[there[same]]
        weight[tuple(lattice[same].T)] = 1.0
        at = ((place_m[here] - low) / edge).T
        totals, weights = (
            map_coordinates(each, at, order=1, mode="grid-constant") for each in (total, weight)
        )
        # no cell of the layer is among the eight around: the weight is zero up to rounding
        found = weights > 1e-9
        result[here[found]] = totals[found] / weights[found]
        rows = same if len(same) else np.arange(len(there))
        rest = here[~found]
        result[rest] = values[there[rows[cKDTree(centre[rows]).query(place_m[rest])[1]]]]
    return result
