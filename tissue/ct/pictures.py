"""Pictures of an imported bone."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from meshes.base.arrays import lattice
from meshes.ct.density import DensityLaw
from meshes.ct.extraction import BoneOfImage
from meshes.ct.inspection import Histogram
from meshes.images.frame import Image
from meshes.surfaces.surface import Surface
from meshes.voxels.mesh_sampling import triangle_distance
from tissue.ct.placing import ImportedPath, Placed
from tissue.show.figures.ct_pictures import (
    Marks,
    draw_ct_bone,
    draw_ct_histogram,
    draw_ct_slices,
    draw_path_depth,
)

__all__ = ["BonePictures"]


@dataclass(frozen=True, eq=False)
class BonePictures:
    """Pictures of a bone with its structures to keep clear of, its site and its path."""

    title: str
    bone: BoneOfImage
    surface: Surface
    clear: Mapping[str, Surface]
    at: Placed | None
    path: ImportedPath | None

    @property
    def _marks(self) -> Marks:
        return Marks(
            None if self.at is None else 1e3 * self.at.site.centre_m,
            None if self.at is None else self.at.site.rotation[:, 2],
            None if self.path is None else self.path.depth.points_mm,
        )

    def draw_slices(self, around: Image, file: Path) -> None:
        """Draw slices of the image around the bone through the site or the bone's middle."""
        middle = 0.5e3 * (self.surface.vertices_m.min(axis=0) + self.surface.vertices_m.max(axis=0))
        part = self.bone.image
        outlines = {"bone": replace(part, values=self.bone.field - np.float32(self.bone.level))}
        for name, surface in self.clear.items():
            outlines[f"{name}, to keep clear of"] = _depth(surface, part)
        marks = self._marks if self.at is not None else replace(self._marks, centre_mm=middle)
        draw_ct_slices(around, file, outlines, marks, title=self.title)

    def draw_histogram(
        self, histogram: Histogram, threshold: float | None, law: DensityLaw | None, file: Path
    ) -> None:
        """Draw the grey values of the image and of the bone."""
        draw_ct_histogram(
            histogram.values,
            histogram.counts,
            self.bone.image.values[self.bone.field > self.bone.level],
            file,
            threshold=threshold,
            density=None if law is None else (law.slope_kg_m3, law.offset_kg_m3),
            title=self.title,
        )

    def draw_bone(self, density: Image | None, file: Path) -> str | None:
        """Draw the bone in 3D; return an error text on failure."""
        return draw_ct_bone(self.surface, file, self._marks, density=density, title=self.title)

    def draw_path(self, file: Path) -> str | None:
        """Draw the path on the bone, coloured by depth; return an error text on failure."""
        normal = self._marks.normal
        assert self.path is not None and normal is not None
        title = self.surface.report.source
        return draw_path_depth(self.surface, self.path.depth, file, normal=normal, title=title)


def _depth(surface: Surface, image: Image) -> Image:
    """Return the depth of an image's voxels within a surface [m], negative outside."""
    axes = [
        o + s * np.arange(n)
        for o, s, n in zip(image.origin_mm, image.spacing_mm, image.values.shape, strict=True)
    ]
    grid = lattice(*axes)
    low = 1e3 * surface.vertices_m.min(axis=0)
    high = 1e3 * surface.vertices_m.max(axis=0)
    around = 2.0 * max(image.spacing_mm)
    near = ((grid > low - around) & (grid < high + around)).all(axis=1)
    depth = np.full(len(grid), -1.0, dtype=np.float32)
    depth[near] = -triangle_distance(surface.vertices_m, surface.faces, 1e-3 * grid[near])
    return replace(image, values=depth.reshape(image.values.shape))
