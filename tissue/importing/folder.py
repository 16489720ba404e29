"""The folder of an import: surfaces, density, labels and what was found, in files that other programs read."""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.whole_file import whole_file
from meshes.ct.imaged_bone import LAW
from meshes.ct.labels import Labels
from meshes.images.frame import Image
from meshes.surfaces.surface import Surface
from tissue.system.owned_folder import listed_files, owned_folder

__all__ = ["RECORD", "SCENE", "Imported", "import_folder", "write_density", "write_labels", "write_surface"]

SCENE, RECORD = "scene.toml", "import.json"


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


@contextmanager
def import_folder(out: Path, files: Sequence[str], record: Mapping[str, Any], *, overwrite: bool) -> Iterator[None]:
    """Write the record of an import, and hold its folder while the block writes the scene and the other files.

    Files of another import in the folder are removed first; all other files in the folder stay.

    Parameters
    ----------
    files
        Names of the files that the block writes beside the scene.
    record
        What was found and assumed, as plain numbers; the names of the files are added.

    Raises
    ------
    InputError
        If one of the files is there and may not be replaced, or the folder cannot be written.
    """
    names = (SCENE, RECORD, *files)
    earlier = listed_files(out).get("import", ())
    with owned_folder(out, "import", {*names, *earlier}, overwrite=overwrite):
        with whole_file(out / RECORD) as temporary:
            listed = {**record, "files": list(names)}
            temporary.write_text(json.dumps(listed, indent=2, ensure_ascii=False) + "\n", "utf-8")
        yield


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
