"""Pictures of an import."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.ct.labelled_bone import cropped
from meshes.ct.labels import Labels
from meshes.images.frame import Image
from meshes.surfaces.surface import Surface
from meshes.voxels.mesh_sampling import triangle_distance
from tissue.figures.ct_pictures import draw_ct_bone, draw_ct_histogram, draw_ct_slices
from tissue.importing.bone import ImportedBone
from tissue.importing.placing import Placed

__all__ = ["PICTURES", "draw_pictures", "draw_tooth"]

PICTURES = ("slices.png", "histogram.png", "bone.png")


def draw_pictures(
    bone: ImportedBone,
    at: Placed | None,
    clear: Mapping[str, Surface],
    out: Path,
    *,
    points_mm: NDArray[np.float64] | None = None,
) -> list[str]:
    """Draw slices, histogram and the bone in 3D; returns why one could not be drawn, a sentence each."""
    found = bone.bone
    title = bone.inspection.source
    middle = 0.5e3 * (bone.surface.vertices_m.min(axis=0) + bone.surface.vertices_m.max(axis=0))
    centre = None if at is None else 1e3 * at.site.centre_m
    normal = None if at is None else at.site.rotation[:, 2]
    draw_ct_slices(
        bone.around,
        out / "slices.png",
        body=("bone", replace(found.image, values=found.field - np.float32(found.level))),
        others={f"{name}, to keep clear of": _inside(surface, found.image) for name, surface in clear.items()},
        centre_mm=middle if centre is None else centre,
        normal=normal,
        points_mm=points_mm,
        title=title,
    )
    inside = found.image.values[found.field > found.level]
    law = bone.law
    draw_ct_histogram(
        bone.histogram.values,
        bone.histogram.counts,
        inside,
        out / "histogram.png",
        threshold=bone.threshold,
        density=None if law is None else (law.slope_kg_m3, law.offset_kg_m3),
        title=title,
    )
    problem = draw_ct_bone(
        bone.surface,
        out / "bone.png",
        density=bone.density,
        centre_mm=centre,
        normal=normal,
        points_mm=points_mm,
        title=title,
    )
    return [] if problem is None else [f"bone.png was not drawn: {problem}"]


def draw_tooth(image: Image, tooth: Labels, file: Path, *, centre_mm: NDArray[np.float64]) -> None:
    """Draw slices of an image with the layers of a tooth, through a point [mm, LPS].

    Parameters
    ----------
    image
        The tooth's CT; without one the image of the labels themselves.
    """
    origin, spacing = np.array(tooth.image.origin_mm), np.array(tooth.image.spacing_mm)
    low, high = origin, origin + spacing * (np.array(tooth.image.values.shape) - 1)
    masks = sorted(((name, tooth.mask(name)) for name in tooth.names.values()), key=lambda each: -each[1].sum())
    outer, *inner = ((name, replace(tooth.image, values=mask - np.float32(0.5))) for name, mask in masks)
    draw_ct_slices(
        cropped(image, ((low[0], low[1], low[2]), (high[0], high[1], high[2]))),
        file,
        body=outer,
        others=dict(inner),
        centre_mm=centre_mm,
        normal=None,
        points_mm=None,
        title=image.source,
    )


def _inside(surface: Surface, image: Image) -> Image:
    """How deep voxels of an image lie within a surface [m], negative outside."""
    axes = [o + s * np.arange(n) for o, s, n in zip(image.origin_mm, image.spacing_mm, image.values.shape, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    low, high = 1e3 * surface.vertices_m.min(axis=0), 1e3 * surface.vertices_m.max(axis=0)
    around = 2.0 * max(image.spacing_mm)
    near = ((grid > low - around) & (grid < high + around)).all(axis=1)
    depth = np.full(len(grid), -1.0, dtype=np.float32)
    depth[near] = -triangle_distance(surface.vertices_m, surface.faces, 1e-3 * grid[near])
    return replace(image, values=depth.reshape(image.values.shape))
