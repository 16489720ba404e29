"""Tetrahedral meshes of segmented organs. Other labels can become named parts of the mesh.

A part is, for example, a tumour or a vessel.

The organ is the union of its own label and the labels of its parts. Parts at the surface of the
organ therefore belong to the organ. If a part reaches the surface of the organ or of an earlier
part, the label of the part is extended a few voxels beyond this surface. Each voxel of this
extension gets the label of the nearest voxel on the inner side of the surface. The surface of the
part then crosses the surface of the organ. Without this extension, the two surfaces would nearly
coincide, and there would be slivers between them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from meshes.base.arrays import (
    Array,
    Flags,
    Ints,
    Triangles,
    box_of,
    enclosed_volume,
)
from meshes.base.errors import InputError, by, counted, names_of_caller, require_range
from meshes.base.progress import Progress, silent
from meshes.ct.labels import Labels
from meshes.images.frame import Image
from meshes.surfaces.surface import Surface, surface_from_triangles
from meshes.tets.quality import describe, repair_tets
from meshes.tets.stuffing import with_inclusion
from meshes.tets.tetrahedra import TetMesh
from meshes.tets.tetrahedralise import FILL_EDGES, tetrahedralise, with_volume
from meshes.voxels.label_shares import spread_labels
from meshes.voxels.mesh_sampling import nearest_on_triangles

_PER_RADIUS = 1.0 / 3.0
"""Ratio of the standard deviation of the smoothing to the radius of the largest ball in the label.

On ellipsoids, smaller values leave voxel steps, and larger values round off the shape.
"""
_DEVIATIONS = (1.0, 2.0)
"""Limits of the standard deviation of the smoothing [voxel].

With more than 2 voxels of usual size, the thin edge of an organ is lost.
"""
_REACH = 4.0
"""Distance from a label up to which its smoothed mask is computed, in standard deviations."""
_LEVELS = (0.25, 0.75)
"""Smallest and largest level of the smoothed label at which the surface is extracted."""
_SLOPE = -1.0
"""First estimate of the derivative of the enclosed volume with respect to the level.

The volume is relative to the volume of the label's voxels. Later estimates are slopes of secants.
"""
_TRIES = 6
_CLOSE = 2e-4
"""Accepted relative volume error in the search for the level of a smoothed label's surface.

The surface should enclose the volume of the label's voxels. At most `_TRIES` levels are tried.
"""


def label_triangles(label: Image) -> Triangles | None:
    """Return the smooth closed surface of a label, with outward normals.

    The result consists of vertices [m], shape (n, 3), and triangles, shape (m, 3).

    The label is smoothed with a kernel that does not shift curved surfaces. The kernel's standard
    deviation is a third of the radius of the largest ball in the label, but at least 1 and at most
    2 voxels. The surface is a level set of the smoothed label. The level is chosen such that the
    surface encloses the volume of the label's voxels. Voxels outside the image count as outside the
    label.

    Parameters
    ----------
    label
        Image whose values are true inside the label.

    Returns
    -------
    Vertices and triangles, or None if the label has too few voxels for a surface.
    """
    from scipy.ndimage import distance_transform_edt

    # Add two more voxels outside, so that the surface is closed for every level in use.
    pad = int(np.ceil(_REACH * _DEVIATIONS[1])) + 2
    crop = box_of(label.values)
    padded = np.pad(label.values[crop], pad)
    radius = float(distance_transform_edt(padded).max())
    deviation = float(np.clip(_PER_RADIUS * radius, *_DEVIATIONS))
    share = spread_labels(padded.astype(np.float32), deviation)
    smooth = label.starting_at([each.start - pad for each in crop], share)
    wanted_m3 = _volume_m3(label)
    low = _LEVELS[0]
    high = min(_LEVELS[1], float(share.max()))
    if low >= high:
        return None
    # The level 0.5 does not shift flat surfaces. The values in a thin label may be below 0.5.
    level = min(0.5, 0.5 * (low + high))
    before = (0.0, 0.0)
    for attempt in range(_TRIES):
        found = _level(smooth, level)
        off = enclosed_volume(*found) / wanted_m3 - 1.0
        if abs(off) < _CLOSE:
            break
        slope = (off - before[0]) / (level - before[1]) if attempt else _SLOPE
        before = off, level
        # A secant between nearly equal levels may have a zero or positive slope, so the slope is
        # limited to a tenth of the first estimate. The limit slightly below the highest value
        # ensures that the surface has points.
        level = float(np.clip(level - off / min(slope, _SLOPE / 10.0), low, high - 1e-3))
    return found


def _volume_m3(mask: Image) -> float:
    """Return the volume of the voxels of a mask [m3]."""
    return 1e-9 * mask.voxel_mm3 * float(np.count_nonzero(mask.values))


def _level(smooth: Image, level: float) -> Triangles:
    from skimage.measure import marching_cubes

    vertices, faces, _, _ = marching_cubes(smooth.values, level, spacing=smooth.spacing_mm)
    vertices = 1e-3 * (vertices.astype(np.float64) + smooth.origin_mm)
    return vertices, faces[:, ::-1].astype(np.int64)


_FEWEST_VOXELS = 64
"""Smallest number of voxels for which a surface is computed: a ball of 5 voxels in diameter."""
_FLAT_END = 0.5
"""Ratio above which an organ's end is flat: voxels of the outermost plane / of the largest plane.

The planes are normal to an image axis. A ball of nine planes, whose end is round, has a ratio of
0.4.
"""
_BEYOND = 4
"""Number of voxels by which a part's label is extended outside the organ."""
_ENVELOPE = 0.2
"""Further extension of a part's label outside the organ, relative to the tetrahedron edge.

The meshing program fTetWild moves the organ's surface by up to half of this extension.
"""


@dataclass(frozen=True, eq=False)
class LabelledOrgan:
    """Masks of an organ and of its parts, from which a mesh can be computed.

    Attributes
    ----------
    name
        Name of the organ's label.
    solid
        Image whose values are the mask of the organ and its parts.
    parts
        Dictionary from part name to mask, in order of precedence.
    notes
        Notes on findings and assumptions, by the name of the organ or part to which they refer.
    """

    name: str
    solid: Image
    parts: dict[str, Flags]
    notes: dict[str, str]

    @cached_property
    def surface(self) -> Surface:
        """Smooth surface of the organ, in the frame of the image."""
        found = label_triangles(self.solid)
        if found is None:
            raise InputError(
                self.name,
                "be at least a few voxels thick",
                "a thinner label",
                "segment a finer image",
            )
        return surface_from_triangles(1e3 * found[0], found[1], source=self.name, scale_mm=1.0)

    def mesh(
        self, edge_mm: float | None = None, *, report: Progress = silent
    ) -> tuple[TetMesh, dict[str, str]]:
        """Return the mesh in the image's frame, and a dictionary from organ or part name to note.

        `edge_mm` is the target edge of the tetrahedra [mm]. If None, it is the longest side of the
        organ's bounding box divided by `FILL_EDGES`.

        Raises
        ------
        InputError
            If the edge is too short or too long for the organ, or a part is too thin.
        """
        longest = max(self.surface.report.size_mm)
        usual = longest / FILL_EDGES
        edge = usual if edge_mm is None else edge_mm
        # Finer meshes have millions of tetrahedra. Coarser meshes do not represent the shape of the
        # organ.
        edge = require_range(
            "edge_mm", edge, longest / 100.0, longest / 4.0, f"use a value such as {usual:.2g}"
        )
        with names_of_caller({"edge_m": "edge_mm"}):
            filled, _ = tetrahedralise(self.surface, edge_m=1e-3 * edge, report=report)
        organ_m3 = _volume_m3(self.solid)
        mesh, notes = self._with_parts(replace(filled, part_names=(self.name,)), edge, report)
        mesh = with_volume(mesh, organ_m3, within_m=1e-3 * edge)
        off = float(mesh.volumes_m3.sum()) / organ_m3 - 1.0
        mesh, repairs = repair_tets(mesh.nodes_m, mesh.cells, mesh.part, mesh.part_names)
        found = (*describe(mesh), *repairs, f"{off:+.2%} of volume relative to the voxels.")
        return mesh, self.notes | notes | {"mesh": " ".join(found)}

    def _with_parts(
        self, mesh: TetMesh, edge_mm: float, report: Progress
    ) -> tuple[TetMesh, dict[str, str]]:
        """Add the parts to the organ's mesh, and return the mesh and a note on each part."""
        notes = {}
        before = np.zeros(self.solid.values.shape, dtype=bool)
        beyond = _BEYOND + int(np.ceil(_ENVELOPE * edge_mm / min(self.solid.spacing_mm)))
        vertices = self.surface.vertices_m
        faces = self.surface.faces

        def onto(points: Array) -> Array:
            return nearest_on_triangles(vertices, faces, points)

        # A part inside another part is added first. The outer part is then closed around it.
        for name, mask in sorted(self.parts.items(), key=lambda part: np.count_nonzero(part[1])):
            report(
                f"cutting {name} out of the tetrahedra",
                len(mesh.part_names) / (len(self.parts) + 1),
            )
            surface = _part_triangles(mask, self.solid, before, beyond)
            if surface is None:
                raise InputError(
                    name,
                    "be at least a few voxels thick",
                    "a thinner label",
                    "leave it out, or segment a finer image",
                )
            volume_m3 = _volume_m3(replace(self.solid, values=mask))
            mesh, size = with_inclusion(mesh, name, *surface, volume_m3=volume_m3, onto=onto)
            notes[name] = " ".join(each for each in (f"{size}.", self.notes.get(name, "")) if each)
            before |= mask
        return mesh, notes


def organ_mesh(
    labels: Labels,
    organ: str,
    parts: Sequence[str] = (),
    *,
    report: Progress = silent,
) -> tuple[TetMesh, dict[str, str]]:
    """Return the tetrahedral mesh of a segmented organ, and notes on findings and assumptions.

    In the mesh, the organ and each label in `parts` are separate named parts.

    Parameters
    ----------
    labels
        Label image with names.
    organ
        Name of the organ's label.
    parts
        Names of labels in the organ or at its surface, such as a tumour or a vessel.
    report
        Function that is called with the current task's name and finished fraction (0 to 1).

    Returns
    -------
    Mesh in the frame of the image, LPS [m], and notes. The parts of the mesh are named as in
    `organ` and `parts`. The key of a note is the name of the organ or part, or ``mesh``.

    Raises
    ------
    InputError
        If a label does not exist, or a part lies outside the organ or is too small.
    """
    return labelled_organ(labels, organ, parts).mesh(report=report)


def labelled_organ(labels: Labels, organ: str, parts: Sequence[str] = ()) -> LabelledOrgan:
    """Find an organ and its parts in a label image.

    For the parameters and errors, see `organ_mesh`.
    """
    twice = [name for name in parts if name == organ or list(parts).count(name) > 1]
    if twice:
        raise InputError(
            "parts",
            "be labels other than the organ, each given once",
            twice[0],
            "remove this name or its repetition",
        )
    whole = labels.mask(organ)
    masks = {name: labels.mask(name) for name in parts}
    body = np.logical_or.reduce([whole, *masks.values()])
    # An empty layer is kept around the organ, except at the edges of the image.
    crop = box_of(body, 1)
    solid, notes = _one_piece(replace(labels.image, values=body).part(crop), whole[crop], organ)
    found = {name: _pieces(name, mask[crop], solid, organ, notes) for name, mask in masks.items()}
    return LabelledOrgan(organ, solid, found, notes)


def _one_piece(body: Image, organ: Flags, name: str) -> tuple[Image, dict[str, str]]:
    """Return the piece with most of the organ's label, with its cavities filled, and notes.

    The notes describe other pieces, and cuts by the edge of the image.
    """
    from scipy.ndimage import binary_fill_holes, label

    notes = []
    pieces = label(body.values)[0]
    sizes = np.bincount(pieces[organ])
    solid = replace(body, values=pieces == int(sizes.argmax()))
    filled = replace(body, values=np.asarray(binary_fill_holes(solid.values), dtype=bool))
    dropped_ml = 1e6 * (_volume_m3(body) - _volume_m3(solid))
    hollow_ml = 1e6 * (_volume_m3(filled) - _volume_m3(solid))
    if dropped_ml:
        loose = counted(int(pieces.max()) - 1, "loose piece")
        notes.append(f"Left out {dropped_ml:.3g} ml in {loose}.")
    if hollow_ml:
        notes.append(f"Filled hollows without a label, {hollow_ml:.3g} ml.")
    notes += _ends(filled)
    size = f"{1e6 * _volume_m3(filled):.4g} ml in voxels of {by(body.spacing_mm, '.3g')} mm."
    return filled, {name: " ".join((size, *notes))}


def _ends(solid: Image) -> list[str]:
    """Return notes on the ends of an organ.

    The notes state where the edge of the image cuts off the organ. They also state where the
    organ's labels may be incomplete.
    """
    notes = []
    cut_mm2 = 0.0
    for axis, name in enumerate("xyz"):
        layers = np.count_nonzero(solid.values, axis=tuple({0, 1, 2} - {axis}))
        area_mm2 = solid.voxel_mm3 / solid.spacing_mm[axis] * layers
        filled = np.flatnonzero(layers)
        for end, last in ((0, filled[0]), (len(layers) - 1, filled[-1])):
            if last == end:
                cut_mm2 += float(area_mm2[end])
            elif layers[last] > _FLAT_END * layers.max():
                at = solid.origin_mm[axis] + solid.spacing_mm[axis] * last
                notes.append(
                    f"It ends flat at {name} = {at:.4g} mm, with "
                    f"an area of {area_mm2[last] / 100.0:.3g} cm2: the labels may end "
                    "there before the organ does."
                )
    if cut_mm2:
        notes.append(
            f"The image cuts it off: {cut_mm2 / 100.0:.3g} cm2 of its surface lie at the edge of "
            "the image. The image does not show the organ beyond this edge."
        )
    return notes


def _pieces(name: str, mask: Flags, solid: Image, organ: str, notes: dict[str, str]) -> Flags:
    """Return the mask of a part in the organ, without pieces that are too small for a surface.

    Notes on problems are added to `notes`.
    """
    from scipy.ndimage import binary_dilation, label

    inside = mask & solid.values
    if not inside.any():
        raise InputError(
            name,
            f"lie in {organ} or touch it",
            "a label that does not touch the organ",
            "leave it out, or correct the segmentation",
        )
    pieces, count = label(inside)
    sizes = np.bincount(pieces.ravel(), minlength=count + 1)
    small = sizes < _FEWEST_VOXELS
    small[0] = False
    kept: Flags = inside & ~small[pieces]
    if not kept.any():
        raise InputError(
            name,
            f"have at least {_FEWEST_VOXELS} connected voxels to have a surface",
            f"{sizes[1:].max()} voxels",
            "leave it out, or segment a finer image",
        )
    remarks = []
    if small.any():
        left = 1e-3 * solid.voxel_mm3 * int(sizes[small].sum())
        pieces_left = counted(int(small.sum()), "piece")
        remarks.append(
            f"{pieces_left} of fewer than {_FEWEST_VOXELS} voxels, {left:.2g} ml, counted as "
            f"{organ}."
        )
    shell = binary_dilation(kept) & ~kept
    outside = int(np.count_nonzero(shell & ~solid.values)) / max(int(np.count_nonzero(shell)), 1)
    if outside:
        remarks.append(
            f"{outside:.0%} of its surface belongs to the surface of {organ}: crop its label if "
            "it should end inside."
        )
    if remarks:
        notes[name] = " ".join(remarks)
    return kept


def _part_triangles(
    mask: Flags, solid: Image, before: Flags, beyond: int
) -> tuple[Array, Ints] | None:
    """Extend the label of a part, and return the surface of the extended label.

    The label is extended outside the organ and into earlier parts. Each voxel of this extension
    gets the label of the nearest voxel in the rest of the organ.
    """
    from scipy.ndimage import distance_transform_edt

    margin = beyond + 2
    box = [(each.start - margin, each.stop + margin) for each in box_of(mask)]
    crop = tuple(slice(max(low, 0), high) for low, high in box)
    padding = [
        (max(-low, 0), max(high - size, 0))
        for (low, high), size in zip(box, mask.shape, strict=True)
    ]
    inside, body, taken = (np.pad(each[crop], padding) for each in (mask, solid.values, before))
    away, nearest = distance_transform_edt(~body | taken, return_indices=True)
    goes_on = inside[tuple(nearest)] & (body | (away <= beyond))
    return label_triangles(solid.starting_at([low for low, _ in box], goes_on))
