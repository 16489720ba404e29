"""Tooth from one closed surface per layer.

The surfaces are moved to the site frame. Overlaps and gaps between layers are measured and assigned
to a layer. A bone socket can be added.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.arrays import Array, Bytes, Floats, Singles, Triangles, lattice
from meshes.base.errors import InputError, names_of_caller, require_range
from meshes.base.grid import Grid
from meshes.base.placement import Placement
from meshes.shapes.anatomy import Anatomy
from meshes.shapes.sdf import Shape
from meshes.surfaces.repair import merge_vertices, triangle_areas
from meshes.surfaces.site import Site, sample_surface
from meshes.surfaces.surface import Surface, UnitError, read_surface
from meshes.tooth.layer_contact import (
    Lattice,
    measure_contact,
    require_pulp_within,
    require_touching,
)
from meshes.tooth.layers import (
    BONE,
    LARGEST_MM,
    LAYER_DENSITY_KG_M3,
    PRIORITY,
    TOOTH_LAYERS,
    lesion_site,
    require_known,
    require_tooth_size,
    tooth_axes,
)
from meshes.voxels.mesh_sampling import (
    TriangleSampler,
    column_crossings,
    inside_scattered,
    triangle_distance,
)
from meshes.voxels.voxelise import voxelise

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_SAMPLE_PITCH_M = 0.1e-3
_MOST_SAMPLES = 300_000
"""Largest number of sample points of a layer's surface. The points are `_SAMPLE_PITCH_M` apart.

The number is enough for a surface of 30 cm2.
"""
_LESION_M = 0.15e-3
"""Edge [m] of the voxels in which a lesion is searched."""
_SOCKET_PITCH_M = 0.2e-3
"""Spacing [m] of the lattice on which distances from the socket are tabulated.

Around a root with a radius of 3 mm, the interpolation error is 2 um.
"""
_FAR_M = 1.0
"""Distance [m] that is returned outside the table of socket distances. No tooth is as long."""
_MERGE_TOLERANCE_M = 1e-8
"""Largest distance [m] at which vertices of two surfaces are merged.

The rounding error of single precision is 2e-9 m.
"""
_DENSITY = np.array([LAYER_DENSITY_KG_M3[name] for name in TOOTH_LAYERS], dtype=np.float32)


@dataclass(frozen=True, eq=False)
class LayeredSolid:
    """Surfaces of a tooth's layers, gaps between layers, and bone socket, in the site frame.

    Attributes
    ----------
    solids
        Dictionary from layer index to vertices [m] and triangles. The first layer has the highest
        priority.
    union
        Combined surface of all layers. It crosses itself where layers overlap.
    samples, sample_layer
        Sample points of all surfaces, and layer index of each point.
    gap
        Lattice that describes the gaps between layers. In a gap, the value is 1 plus the index of
        the layer to which the gap is assigned. Outside gaps, the value is 0.
    socket
        Lattice with the distance from the bone socket [m], negative inside. Without a socket, the
        lattice is one distant point.
    """

    solids: Mapping[int, Triangles]
    union: Triangles
    samples: cKDTree
    sample_layer: Bytes
    gap: Lattice
    socket: Lattice

    def distance(self, points: Floats) -> Floats:
        """Compute the signed distance [m] of points [m], shape (n, 3), from the solid.

        The distance is negative inside.
        """
        away = np.minimum(
            triangle_distance(*self.union, points), self.socket(points, beyond=_FAR_M)
        )
        return away.astype(points.dtype)

    def sample(self, grid: Grid) -> tuple[Singles, Singles]:
        """Compute the solid fraction and the depth of each voxel of a grid.

        See `meshes.shapes.anatomy.GridSampler`.
        """
        fraction, depth = TriangleSampler(*self.union)(grid)
        index = np.nonzero(fraction < 1.0)
        points = np.stack(
            [(i + f + 0.5) * grid.spacing_m for i, f in zip(index, grid.first, strict=True)], axis=1
        )
        is_gap = replace(self.gap, values=(self.gap.values > 0).astype(np.float32))
        filled = np.minimum(fraction[index] + is_gap(points, beyond=0.0), 1.0)
        away = self.socket(points, beyond=_FAR_M)
        # A plane at this distance cuts the voxel. The part that is not in a layer is bone.
        filled += (1.0 - filled) * np.clip(0.5 - away / np.float32(grid.spacing_m), 0.0, 1.0)
        depth[index] = np.where(fraction[index] > 0.0, np.maximum(depth[index], -away), -away)
        fraction[index] = filled
        return fraction, depth

    def classify(self, points: Floats, depth: Floats) -> tuple[Bytes, Floats]:
        """Return the layer and the density [kg/m3] at given points.

        See `meshes.shapes.anatomy.Classify`.

        A point in several layers belongs to the layer with the highest priority. A point in a gap
        belongs to the layer to which the gap is assigned. A point outside layers and gaps belongs
        to the bone if it lies in the socket or is nearer to the socket than to all layers.
        Otherwise, it belongs to the nearest layer.
        """
        layer = np.full(len(points), len(TOOTH_LAYERS), dtype=np.uint8)
        left = np.arange(len(points))
        for index, (vertices, faces) in self.solids.items():
            held = inside_scattered(vertices, faces, points[left])
            layer[left[held]] = index
            left = left[~held]
        gap = self.gap.nearest(points[left])
        layer[left[gap > 0]] = gap[gap > 0] - 1
        left = left[gap == 0]
        away = self.socket(points[left], beyond=_FAR_M)
        layer[left[away <= 0.0]] = BONE
        left = left[away > 0.0]
        away = away[away > 0.0]
        distance, nearest = self.samples.query(points[left])
        layer[left] = np.where(away < distance, BONE, self.sample_layer[nearest])
        return layer, _DENSITY[layer]


def joined(solids: Sequence[Triangles]) -> Triangles:
    """Join several surfaces, and remove coincident triangles of opposite orientation."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in solids)])
    vertices = np.concatenate([vertices for vertices, _ in solids])
    faces = np.concatenate(
        [faces + start for (_, faces), start in zip(solids, starts, strict=False)]
    )
    return merge_vertices(vertices, faces, _MERGE_TOLERANCE_M)


def _socket(ligament: Array, others: Array, margin: float) -> Lattice:
    """Tabulate the distance [m] from the bone socket.

    The socket consists of the points within `margin` [m] of the ligament's surface. Points that are
    nearer to another layer than to the ligament are excluded.

    Parameters
    ----------
    ligament, others
        Points [m], shape (n, 3), on the surface of the ligament, and on the surfaces of the other
        layers.
    """
    from scipy.spatial import cKDTree

    low = ligament.min(axis=0) - margin - 2.0 * _SOCKET_PITCH_M
    reach = margin + 2.0 * _SOCKET_PITCH_M
    count = np.ceil((ligament.max(axis=0) + reach - low) / _SOCKET_PITCH_M).astype(int) + 1
    points = low + _SOCKET_PITCH_M * lattice(*map(np.arange, count))
    # Every fourth point is used. These points are 0.2 mm apart, the spacing of the table.
    away = np.minimum(cKDTree(ligament[::4]).query(points, distance_upper_bound=reach)[0], reach)
    near = np.flatnonzero(away < reach)
    signed = away - margin
    signed[near] = np.maximum(
        signed[near], away[near] - cKDTree(others[::4]).query(points[near])[0]
    )
    return Lattice(low, _SOCKET_PITCH_M, signed.reshape(count).astype(np.float32))


def layered_surfaces(
    paths_by_layer: Mapping[str, str | Path],
    *,
    scale_mm: float | None = None,
    socket_mm: float = 0.0,
    at_lesion: bool = False,
) -> Anatomy:
    """Read a tooth from surface files with a common frame and unit, one closed surface per layer.

    Parameters
    ----------
    paths_by_layer
        Dictionary from layer name to file. Enamel and dentin are required.
    scale_mm
        Millimetres per unit of the files. If None, the unit of all files is guessed from the size
        of the dentin.
    socket_mm, at_lesion
        See `layered_anatomy`.

    Raises
    ------
    InputError
        If a file cannot be used. `layered_anatomy` lists further errors.
    """
    require_known(paths_by_layer, "paths_by_layer")
    dentin = _read("dentin", paths_by_layer["dentin"], scale_mm)
    scale = dentin.report.scale_mm
    surfaces = {
        name: dentin if name == "dentin" else _read(name, path, scale)
        for name, path in paths_by_layer.items()
    }
    return layered_anatomy(surfaces, socket_mm=socket_mm, at_lesion=at_lesion)


def _read(layer: str, path: str | Path, scale_mm: float | None) -> Surface:
    """Read the surface of a layer. Error messages name the layer."""
    with names_of_caller(
        {word: f"{layer} {word}" for word in ("file", "surface", "vertices", "faces", "cells")}
    ):
        try:
            return read_surface(path, scale_mm=scale_mm)
        except UnitError as refusal:
            if refusal.suggested_mm <= LARGEST_MM:
                raise
            # The suggested scale would give the size of a larger bone.
            refusal.remedy = (
                f"the file or its unit may be wrong: use a file of the {layer} in the unit of the "
                "other layers, or give the millimetres per unit of all files"
            )
            raise


def layered_anatomy(
    surfaces: Mapping[str, Surface],
    *,
    socket_mm: float = 0.0,
    at_lesion: bool = False,
    at: Site | None = None,
) -> Anatomy:
    """Build a tooth from one closed surface per layer, in the site frame of teeth.

    The long axis of the tooth passes through the middle of the enamel. The origin is the point
    where this axis leaves the enamel, or the dentin if the axis does not cross enamel. A thin bur
    that moves down this axis first touches the tooth at the origin. z points from the roots to the
    crown. x points in the direction in which the roots have the largest extent. A voxel that
    contains parts of several layers is completely filled and belongs to the layer at the voxel's
    centre. On average, the volume of each layer is therefore correct. An overlap of two layers, or
    a gap between two layers, is assigned to the layer that comes first in
    `meshes.tooth.layers.PRIORITY`.

    Parameters
    ----------
    surfaces
        Dictionary from layer name to surface. Enamel and dentin are required. The surface of the
        dentin may be hollow or include the pulp.
    socket_mm
        Thickness of the bone that is added around the ligament [mm], 0 (no bone) to 10. The bone
        consists of points that are nearer to the ligament than to all other layers of the tooth.
    at_lesion
        Whether the site's origin lies above the lesion, see `meshes.tooth.layers.lesion_site`.
    at
        Site in the frame of the surfaces. If None, the function searches for the site.

    Raises
    ------
    InputError
        If a layer is unknown, if enamel or dentin is missing, or if the size is not plausible for a
        tooth. The error is also raised if layers do not touch or the pulp lies outside the dentin.
        A positive `socket_mm` requires a ligament and no bone surface.
    """
    require_known(surfaces, "surfaces")
    # 10 mm is more than the thickness of bone around a root.
    margin = 1e-3 * require_range("socket_mm", socket_mm, 0.0, 10.0, "use 2.5, or 0 for none")
    if margin > 0.0 and ("ligament" not in surfaces or "bone" in surfaces):
        raise InputError(
            "socket_mm",
            "be 0 without a ligament or with a bone surface",
            f"{socket_mm:g}",
            "add the ligament, or leave the socket out",
        )
    samples = {name: _spread(surface) for name, surface in surfaces.items()}
    require_touching(
        samples, {name: (surface.vertices_m, surface.faces) for name, surface in surfaces.items()}
    )
    scale = surfaces["dentin"].report.scale_mm
    if "bone" not in surfaces:
        size_mm = 1e3 * float(np.ptp(np.concatenate(list(samples.values())), axis=0).max())
        require_tooth_size(size_mm, "scale_mm", f"{scale:g}", size_mm / scale)
    if at_lesion:
        upright = layered_anatomy(surfaces)
        assert upright.placement is not None
        found = lesion_site(voxelise(upright, spacing_m=_LESION_M))
        return layered_anatomy(surfaces, socket_mm=socket_mm, at=found.within(upright.placement))
    centre, rotation, note = (
        _site(surfaces, samples) if at is None else (at.centre_m, at.rotation, at.confidence)
    )
    placed = {
        name: ((surfaces[name].vertices_m - centre) @ rotation, surfaces[name].faces)
        for name in PRIORITY
        if name in surfaces
    }
    samples = {name: (points - centre) @ rotation for name, points in samples.items()}
    if "pulp" in surfaces:
        require_pulp_within(samples["pulp"], placed["dentin"], samples["dentin"])
    gap, fit = measure_contact(placed)
    solid = _solid(placed, samples, gap, margin)
    notes = _notes(surfaces, note, socket_mm) | {"order of layers": " > ".join(placed)} | fit
    placement = Placement(1e3 * centre, rotation, scale)
    points = np.concatenate(list(samples.values()))
    high = np.maximum(points.max(axis=0), samples.get("ligament", points).max(axis=0) + margin)
    shape = Shape(
        solid.distance, tuple((points.min(axis=0) - margin).tolist()), tuple(high.tolist())
    )
    return Anatomy(
        "tooth from surfaces", shape, TOOTH_LAYERS, solid.classify, notes, solid.sample, placement
    )


def _solid(
    placed: Mapping[str, Triangles],
    samples: Mapping[str, Array],
    gap: Lattice,
    margin: float,
) -> LayeredSolid:
    """Combine the layers in the site frame, and add a bone socket with the thickness `margin` [m].

    The first layer has the highest priority.
    """
    from scipy.spatial import cKDTree

    layer = np.concatenate(
        [np.full(len(samples[name]), TOOTH_LAYERS.index(name), np.uint8) for name in samples]
    )
    socket = Lattice(np.zeros(3), _FAR_M, np.full((1, 1, 1), _FAR_M, dtype=np.float32))
    if margin > 0.0:
        others = np.concatenate([points for name, points in samples.items() if name != "ligament"])
        socket = _socket(samples["ligament"], others, margin)
    return LayeredSolid(
        {TOOTH_LAYERS.index(name): placed[name] for name in placed},
        joined([placed[name] for name in samples]),
        cKDTree(np.concatenate(list(samples.values()))),
        layer,
        gap,
        socket,
    )


def _spread(surface: Surface) -> Array:
    """Return sample points [m], shape (n, 3), of a surface, about 0.1 mm apart."""
    area = float(triangle_areas(surface.vertices_m, surface.faces).sum())
    # At least 1000 points are needed to compute axes and distances of a small layer.
    count = int(np.clip(area / _SAMPLE_PITCH_M**2, 1000, _MOST_SAMPLES))
    return sample_surface(surface.vertices_m, surface.faces, count).points


def _site(
    surfaces: Mapping[str, Surface], samples: Mapping[str, Array]
) -> tuple[Array, Array, str]:
    """Find the origin [m] and the axes of the tooth's site in the frame of the surfaces.

    The returned text describes the method.
    """
    body = np.concatenate(
        [points for name, points in samples.items() if name not in ("enamel", "bone")]
    )
    axes = tooth_axes(samples["enamel"], body)
    # The enamel on the axis may be missing because of a lesion.
    for name in ("enamel", "dentin"):
        placed = (surfaces[name].vertices_m - axes.middle_m) @ axes.rotation
        # 1 nm off the axis, because edges of symmetric meshes lie on the axis.
        found = column_crossings(placed, surfaces[name].faces, np.array([1e-9]), np.array([1e-9]))
        if len(found.height):
            origin = axes.middle_m + found.height.max() * axes.rotation[:, 2]
            return origin, axes.rotation, f"{axes.note}; origin on the {name}"
    raise InputError(
        "layers",
        "lie on the tooth's long axis",
        "neither enamel nor dentin there",
        "check which layer is which",
    )


def _notes(surfaces: Mapping[str, Surface], note: str, socket_mm: float) -> dict[str, str]:
    """Return measured values and assumptions as texts for reports."""
    notes = {
        "surfaces": ", ".join(
            f"{name} {surface.report.volume_mm3:.4g} mm3" for name, surface in surfaces.items()
        ),
        "unit": surfaces["dentin"].report.unit_guess,
        "long axis": note,
        "mesial and buccal": "not distinguished: x is the wider direction of the roots",
        "densities": "by layer, assumed",
    }
    if "pulp" not in surfaces:
        notes["pulp"] = "none given: distance and exposure of the pulp are unknown"
    if "ligament" not in surfaces:
        held = "at the bone" if "bone" in surfaces else "at its lower third"
        notes["ligament"] = f"none given. To compute stress, the tooth is held {held}"
    if socket_mm > 0.0:
        notes["bone"] = f"added by the program, {socket_mm:g} mm around the ligament"
    return notes
