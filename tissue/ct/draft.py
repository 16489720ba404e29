"""Output of an import: files for other programs, the text of a scene, and a record of results."""

import json
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.progress import Progress
from meshes.base.whole_file import whole_file, write_text
from meshes.ct.bone_inside import LAW
from meshes.ct.labels import Labels
from meshes.images.frame import Image
from meshes.surfaces.surface import Surface
from tissue.scene.scene import Scene
from tissue.system.owned_folder import OwnedFolder, listed_files

SCENE = "scene.toml"
RECORD = "import.json"
Writer = Callable[[Path], str | None]
"""Function that writes a file, and returns a sentence if the file could not be written."""
ARRAY = re.compile(r"(?<== )\[[^\"]*?\n\]")
"""Regular expression for an array that is written on several lines."""


@dataclass(frozen=True)
class Draft:
    """Content of the output folder of an import.

    Attributes
    ----------
    scene
        TOML of the scene.
    record
        Measured and assumed values of the import, as plain numbers.
    files
        Functions that write the other files, one for each file, keyed by file name. Pictures are
        last.
    sentences
        Description of the import for users.
    has_site
        True if the scene contains the site that a run needs, or if a run needs no site.
    """

    scene: str
    record: Mapping[str, Any]
    files: Mapping[str, Writer]
    sentences: list[str]
    has_site: bool = True

    def write(self, out: Path, *, overwrite: bool, pictures: bool, progress: Progress) -> list[str]:
        """Write the output folder; return `sentences`, and one more for each picture that failed.

        Files of an earlier import in the folder are removed first. Other files in the folder are
        kept.

        Raises
        ------
        InputError
            If a file exists and may not be replaced, or the folder cannot be written.
        """
        import tissue

        wanted = [name for name in self.files if pictures or not name.endswith(".png")]
        names = (SCENE, RECORD, *wanted)
        record = {
            "tissue": tissue.__version__,
            **self.record,
            "sentences": self.sentences,
            "files": names,
        }
        sentences = list(self.sentences)
        with OwnedFolder(
            out, "import", {*names, *listed_files(out).get("import", ())}, overwrite=overwrite
        ):
            write_text(out / RECORD, json.dumps(record, indent=2, ensure_ascii=False) + "\n")
            write_text(out / SCENE, self.scene)
            for name in wanted:
                progress("drawing" if name.endswith(".png") else "writing files", 0.0)
                problem = self.files[name](out / name)
                if problem is not None:
                    sentences.append(f"{name} was not drawn: {problem}")
        return sentences


def write_surface(surface: Surface, path: Path) -> None:
    """Write a surface as binary PLY, with coordinates [mm] in the surface's own frame."""
    import pyvista

    mesh = pyvista.PolyData.from_regular_faces(1e3 * surface.vertices_m, surface.faces.astype(int))
    with whole_file(path) as temporary:
        mesh.save(temporary, binary=True)


def write_density(density: Image, path: Path, *, law: str) -> None:
    """Write densities as NRRD in LPS, rounded to 1 kg/m3.

    `law` is a text that describes the origin and the uncertainty of the densities.
    """
    _write_image(density, path, {"content": "apparent density kg/m3", LAW: law})


def write_labels(labels: Labels, path: Path) -> None:
    """Write labels with their names in the segmentation format of 3D Slicer (`.seg.nrrd`).

    A voxel with several labels is written with the label of the smallest structure.
    """
    if labels.overlaps:
        names = dict.fromkeys(labels.names.values())
        sizes = {each: int(np.count_nonzero(labels.mask(each))) for each in names}
        labels = labels.only(sorted(names, key=lambda each: -sizes[each]))
    size = labels.image.values.shape
    extent = f"0 {size[0] - 1} 0 {size[1] - 1} 0 {size[2] - 1}"
    about = {
        "Segmentation_MasterRepresentation": "Binary labelmap",
        "Segmentation_ContainedRepresentationNames": "",
    }
    for index, (number, name) in enumerate(sorted(labels.names.items())):
        keys = {"ID": name, "Name": name, "LabelValue": str(number), "Layer": "0", "Extent": extent}
        about |= {f"Segment{index}_{key}": value for key, value in keys.items()}
    _write_image(labels.image, path, about)


def _write_image(image: Image, path: Path, about: Mapping[str, str]) -> None:
    """Write a compressed image with ITK."""
    import SimpleITK

    stored = SimpleITK.GetImageFromArray(np.ascontiguousarray(image.values.T))
    stored.SetSpacing(image.spacing_mm)
    stored.SetOrigin(image.origin_mm)
    for key, value in about.items():
        stored.SetMetaData(key, value)
    with whole_file(path) as temporary:
        SimpleITK.WriteImage(stored, str(temporary), True)


def scene_name(folder: Path) -> str:
    """Return the name of the scene, derived from the name of the output folder."""
    plain = re.sub(r"[^a-z0-9_-]+", "-", folder.resolve().name.lower()).strip("-_")
    return plain or "imported"


def scene_tables(scene: Scene, keys: Iterable[str]) -> dict[str, Any]:
    """Return the given keys and tables of a scene, without values equal to their defaults.

    The duration is left out if the motion is a path of points, because a run then lasts as long as
    its path. A copied duration would stop the tool early on a longer path.
    """
    stated = scene.model_dump(mode="json", exclude_unset=True, exclude_none=True)
    if "points_mm" in stated.get("motion", {}):
        stated.pop("duration_s", None)
    return {key: stated[key] for key in keys if key in stated}


def toml(table: Mapping[str, object]) -> str:
    """Return the TOML text of a table, with each array of numbers on one line."""
    import tomli_w

    def on_a_line(array: re.Match[str]) -> str:
        return re.sub(r",? \]", "]", " ".join(array[0].split()).replace("[ ", "["))

    return ARRAY.sub(on_a_line, tomli_w.dumps(dict(table)))
