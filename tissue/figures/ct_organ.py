"""A soft organ of a segmentation: three slices with its labels, beside the surface of its tetrahedra."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.images.frame import Image, part_of
from meshes.tets.tetrahedra import TetMesh
from meshes.voxels.mesh_sampling import triangle_distance
from tissue.figures.ct_slices import SOFT_HU, draw_ct_slices

__all__ = ["draw_ct_organ"]

AROUND_MM = 10.0


def draw_ct_organ(
    image: Image, path: Path, *, masks: Mapping[str, NDArray[np.bool_]], mesh: TetMesh, title: str
) -> None:
    """Draw slices through the middle of the smallest part, with the outlines of the meshed organ and of the labels.

    Parameters
    ----------
    masks
        The organ first, then its parts, of the image's shape.
    mesh
        Its tetrahedra in the frame of the image.
    """
    organ, *parts = masks
    spacing, origin = np.array(image.spacing_mm), np.array(image.origin_mm)
    low = np.floor((1e3 * mesh.nodes_m.min(axis=0) - AROUND_MM - origin) / spacing).astype(int).clip(0)
    high = np.ceil((1e3 * mesh.nodes_m.max(axis=0) + AROUND_MM - origin) / spacing).astype(int) + 1
    part = tuple(map(slice, low.tolist(), np.minimum(high, image.values.shape).tolist()))
    around = part_of(image, part)
    smallest = min(parts or [organ], key=lambda name: int(np.count_nonzero(masks[name])))
    middle = origin + spacing * np.argwhere(masks[smallest]).mean(axis=0)
    vertices, faces = mesh.nodes_m, mesh.surface
    sizes = zip(around.origin_mm, around.spacing_mm, around.values.shape, strict=True)
    axes = [o + s * np.arange(n) for o, s, n in sizes]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    depth = -triangle_distance(vertices, faces, 1e-3 * grid).reshape(around.values.shape)
    draw_ct_slices(
        around,
        path,
        body=(f"{organ}, meshed", replace(around, values=depth.astype(np.float32))),
        others={name: replace(around, values=masks[name][part] - np.float32(0.5)) for name in parts},
        centre_mm=middle,
        normal=None,
        points_mm=None,
        title=title,
        window_HU=SOFT_HU,
    )
