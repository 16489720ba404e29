"""The folder of an import: surfaces, density, labels and what was found, in files that other programs read."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.whole_file import whole_file
from meshes.ct.imaged_bone import LAW
from meshes.ct.labels import Labels
from meshes.images.frame import Image
from meshes.surfaces.surface import Surface

__all__ = ["Imported", "write_density", "write_labels", "write_record", "write_surface"]


@dataclass(frozen=True)
class Imported:
    """What an import has written.

    Attributes
    ----------
    folder
        Where.
    scene
        The scene's file.
    has_site
        Whether the scene can be run as it is.
    sentences
        What was found and assumed.
    """

    folder: Path
    scene: Path
    has_site: bool
    sentences: tuple[str, ...]


def write_surface(surface: Surface, path: Path) -> None:
    """Write a surface as binary PLY in mm, in its own frame."""
    import pyvista

    mesh = pyvista.PolyData.from_regular_faces(1e3 * surface.vertices_m, surface.faces.astype(int))
    with whole_file(path) as temporary:
        mesh.save(temporary, binary=True)


def write_density(density: Image, path: Path, *, law: str) -> None:
    """Write densities as NRRD, whole kg/m3, in LPS; `law` states where they come from and how sure they are."""
    _write(density, path, {"content": "apparent density kg/m3", LAW: law})


def write_labels(labels: Labels, path: Path) -> None:
    """Write labels with their names as 3D Slicer reads them (`.seg.nrrd`)."""
    size = labels.image.values.shape
    extent = f"0 {size[0] - 1} 0 {size[1] - 1} 0 {size[2] - 1}"
    about = {"Segmentation_MasterRepresentation": "Binary labelmap", "Segmentation_ContainedRepresentationNames": ""}
    for index, (number, name) in enumerate(sorted(labels.names.items())):
        about |= {
            f"Segment{index}_ID": name,
            f"Segment{index}_Name": name,
            f"Segment{index}_LabelValue": str(number),
            f"Segment{index}_Layer": "0",
            f"Segment{index}_Extent": extent,
        }
    _write(labels.image, path, about)


def write_record(record: Mapping[str, Any], path: Path) -> None:
    """Write what was found and assumed as JSON."""
    with whole_file(path) as temporary:
        temporary.write_text(json.dumps(record, indent=2, ensure_ascii=False) + "\n", "utf-8")


def _write(image: Image, path: Path, about: Mapping[str, str]) -> None:
    """Write an image by ITK, compressed."""
    import SimpleITK

    stored = SimpleITK.GetImageFromArray(np.ascontiguousarray(image.values.T))
    stored.SetSpacing(image.spacing_mm)
    stored.SetOrigin(image.origin_mm)
    for key, value in about.items():
        stored.SetMetaData(key, value)
    with whole_file(path) as temporary:
        SimpleITK.WriteImage(stored, str(temporary), True)
