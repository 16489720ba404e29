"""Label volumes with the names of their labels, in one file or one file per label.

Both are layouts that programs write.
"""

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Flags
from meshes.base.errors import InputError, by, is_folder, require_file
from meshes.base.text_tables import read_toml
from meshes.images.data import first_bytes
from meshes.images.frame import Image
from meshes.images.reading import read_image
from meshes.images.text_headers import header_lines

__all__ = ["Labels", "header_names", "label_sets", "on_grid_of", "read_labels"]

_MOST_LABELS = 255
"""Largest number of a label: labels are kept as bytes."""
_HEADER_BYTES = 1 << 20
"""Bytes of a NIfTI file that are searched for a table of labels: 4 kB for each of 255 names."""
_XML_NAME = re.compile(r'<Label Key="(\d+)"[^>]*>\s*<!\[CDATA\[(.*?)\]\]>', re.DOTALL)
"""Line of the label table in an extension of a NIfTI header (Caret, TotalSegmentator)."""
_SAME_PLACE = 1e-2
"""Largest distance between grids that count as equal [voxel]."""
_SHOWN_NAMES = 12
"""Names that an error message lists."""


@dataclass(frozen=True, eq=False)
class Labels:
    """A label volume in LPS [mm] and the names of its labels.

    Attributes
    ----------
    image
        Whole numbers, 0 for no label, shape (nx, ny, nz).
    names
        Name of each label that the volume holds, by its number.
    """

    image: Image
    names: Mapping[int, str]

    def number(self, name: str) -> int:
        """Return the number of a label.

        Raises
        ------
        InputError
            If no label has that name; the message lists the available names.
        """
        found = [
            number for number, each in self.names.items() if each == name or str(number) == name
        ]
        if not found:
            known = list(self.names.values())
            near = [each for each in known if name in each or each in name] or known
            shown = ", ".join(near[:_SHOWN_NAMES])
            more = f" and {len(near) - _SHOWN_NAMES} more" if len(near) > _SHOWN_NAMES else ""
            raise InputError(
                "label", f"be one that {self.image.source} holds", name, f"use one of {shown}{more}"
            )
        return found[0]

    def mask(self, name: str) -> Flags:
        """Return the voxels of a label, or of all labels with its name, shape of the image.

        It raises the same errors as `number`.
        """
        one = self.number(name)
        alike = [number for number, each in self.names.items() if each == self.names[one]]
        # A comparison is several times faster than `isin`, and names are rarely shared.
        found: Flags = (
            self.image.values == one if len(alike) == 1 else np.isin(self.image.values, alike)
        )
        return found


@cache
def label_sets() -> dict[str, tuple[str, ...]]:
    """Return the names of labels by the program that writes them, ordered by number from 1."""
    table = tomllib.loads(files("meshes.ct").joinpath("label_sets.toml").read_text("utf-8"))
    return {name: tuple(entry["names"]) for name, entry in table.items()}


def read_labels(
    path: str | Path, *, names: str | Path | None = None, spacing_mm: float | None = None
) -> Labels:
    """Read a label volume, or a folder of masks with one mask per label, and the label names.

    Parameters
    ----------
    path
        Image whose values are labels, names in its header or given (`.seg.nrrd` of 3D Slicer,
        `.nii.gz`); or a folder of masks, one a file, each named as its label.
    names
        One of `label_sets`, or a TOML file of a table ``[labels]`` that gives each name its number;
        None: the names in the file's own header, else ``label 1`` and so on.
    spacing_mm
        Distance between neighbours [mm] of a file that does not state it.

    Raises
    ------
    InputError
        If a file cannot be used, values are not labels, masks lie on different grids, or a name has
        no number.
    """
    path = Path(path)
    if is_folder(path):
        if names is not None:
            raise InputError(
                "names",
                "be left out for a folder of masks, whose files name them",
                names,
                "remove it",
            )
        return _of_masks(path)
    image = read_image(path, spacing_mm=spacing_mm, labels=True)
    values = _whole(image)
    held = [
        int(number) for number in np.flatnonzero(np.bincount(values.ravel(), minlength=2)) if number
    ]
    if not held:
        raise InputError(
            "labels", "mark something", f"0 everywhere in {image.source}", "export the segmentation"
        )
    stated = _given(names) if names is not None else header_names(path)
    if names is not None and (unknown := [number for number in held if number not in stated]):
        raise InputError(
            "names",
            f"name every label of {image.source}",
            f"none for {by(unknown[:5])}",
            f"add them to {names}",
        )
    known = {number: stated.get(number, f"label {number}") for number in held}
    notes = (*image.notes, *_shared_names(known, image.source))
    return Labels(replace(image, values=values, notes=notes), known)


def on_grid_of(labels: Labels, image: Image) -> Labels:
    """Return labels on the voxels of another image.

    They are unchanged where the grids agree, else the nearest labels, with a note.
    """
    from scipy.ndimage import affine_transform

    one = labels.image
    other = image
    scale = np.array(other.spacing_mm) / one.spacing_mm
    shift = (np.array(other.origin_mm) - one.origin_mm) / one.spacing_mm
    # An error of the spacing adds up over the grid.
    if (
        one.values.shape == other.values.shape
        and np.abs(shift).max() < _SAME_PLACE
        and (np.abs(scale - 1.0) * one.values.shape).max() < _SAME_PLACE
    ):
        return labels
    values = affine_transform(
        one.values, scale, shift, other.values.shape, order=0, mode="constant", cval=0
    )
    if one.values.any() and not values.any():
        raise InputError(
            "labels",
            "lie where the image does",
            f"{one.source} outside {other.source}",
            "give those of this image",
        )
    note = (
        f"{one.source} has {by(one.values.shape)} voxels of {by(one.spacing_mm, '.4g')} mm: "
        "each voxel of "
        f"{other.source} takes the nearest label."
    )
    held = set(np.unique(values).tolist())
    placed = replace(other, values=values, source=one.source, notes=(*one.notes, note))
    return Labels(placed, {number: name for number, name in labels.names.items() if number in held})


def _of_masks(folder: Path) -> Labels:
    """Read a folder of masks; a voxel of two masks takes the later name, with a note."""
    masks = sorted(
        file
        for file in folder.iterdir()
        if file.name.lower().endswith((".nii", ".nii.gz", ".nrrd"))
    )
    if not masks:
        raise InputError(
            "labels",
            "be a file or a folder of masks",
            f"{folder.name} without .nii.gz or .nrrd files",
            "give the folder that TotalSegmentator wrote",
        )
    if len(masks) > _MOST_LABELS:
        raise InputError(
            "labels",
            f"be at most {_MOST_LABELS}",
            f"{len(masks)} masks in {folder.name}",
            "remove some",
        )
    whole: Image | None = None
    names: dict[int, str] = {}
    notes: list[str] = []
    for number, file in enumerate(masks, start=1):
        image = read_image(file, labels=True)
        if whole is None:
            whole = replace(
                image,
                values=np.zeros(image.values.shape, dtype=np.uint8),
                source=folder.name,
                notes=(),
            )
        # 1e-3 mm: headers round spacing and origin.
        if image.values.shape != whole.values.shape or not np.allclose(
            [*image.spacing_mm, *image.origin_mm], [*whole.spacing_mm, *whole.origin_mm], atol=1e-3
        ):
            raise InputError(
                "masks",
                "lie on one grid",
                f"another in {file.name} of {folder.name}",
                "export them together",
            )
        inside = image.values > 0
        if not inside.any():
            continue
        name = re.sub(r"\.(nii|nii\.gz|nrrd)$", "", file.name, flags=re.IGNORECASE)
        if (overlap := int(np.count_nonzero(whole.values[inside]))) > 0:
            notes.append(f"{name} covers {overlap} voxels of masks before it in {folder.name}.")
        whole.values[inside] = number
        names[number] = name
    assert whole is not None
    if not names:
        raise InputError(
            "labels",
            "mark something",
            f"empty masks only in {folder.name}",
            "export the segmentation",
        )
    notes += _shared_names(names, folder.name)
    return Labels(replace(whole, notes=tuple(notes)), names)


def _shared_names(names: Mapping[int, str], source: str) -> list[str]:
    """Return a note on each name that several labels have."""
    numbers: dict[str, list[int]] = {}
    for number, name in names.items():
        numbers.setdefault(name, []).append(number)
    return [
        f"{source} has {len(each)} labels named {name} ({', '.join(map(str, each))}): "
        "they are taken as one."
        for name, each in numbers.items()
        if len(each) > 1
    ]


def _whole(image: Image) -> NDArray[np.integer]:
    """Return the values as bytes."""
    low = float(image.values.min())
    high = float(image.values.max())
    if low < 0 or high > _MOST_LABELS or not np.array_equal(image.values, np.rint(image.values)):
        raise InputError(
            "labels",
            f"be whole numbers from 0 to {_MOST_LABELS}",
            f"{low:g} to {high:g} in {image.source}",
            "give the segmentation, not the image",
        )
    return image.values.astype(np.uint8)


def _given(names: str | Path) -> dict[int, str]:
    """Return the names by number of a known program or of a TOML file."""
    if str(names) in label_sets():
        return dict(enumerate(label_sets()[str(names)], start=1))
    file = Path(names)
    if file.suffix != ".toml":
        raise InputError(
            "names",
            f"be one of {', '.join(label_sets())} or a TOML file",
            names,
            "write [labels] with a line such as cortical = 1",
        )
    require_file(file, "names of labels")
    try:
        table = read_toml(file.read_text("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as problem:
        raise InputError(
            "names", "be readable TOML", f"{file.name} which is not", str(problem)
        ) from problem
    labels = table.get("labels")
    if not isinstance(labels, dict):
        labels = {}
    numbers = list(labels.values())
    whole = all(type(number) is int and 1 <= number <= _MOST_LABELS for number in numbers)
    if set(table) != {"labels"} or not whole or not 0 < len(numbers) == len(set(numbers)):
        raise InputError(
            "names",
            f"be in one table [labels], each with a number of its own from 1 to {_MOST_LABELS}",
            f"{numbers or ', '.join(table) or 'nothing'} in {file.name}",
            "write [labels] with a line such as cortical = 1",
        )
    return {number: name for name, number in labels.items()}


def header_names(path: Path) -> dict[int, str]:
    """Return the names that an image's own header gives its labels."""
    name = path.name.lower()
    if name.endswith((".nii", ".nii.gz")):
        text = first_bytes(path, _HEADER_BYTES).decode("latin-1")
        return {int(number): label.strip() for number, label in _XML_NAME.findall(text)}
    if not name.endswith((".nrrd", ".nhdr")):
        return {}
    fields, _ = header_lines(path, ":", "")
    names: dict[int, str] = {}
    for key, value in fields.items():
        if found := re.fullmatch(r"segment(\d+)_name", key):
            # NRRD separates such keys by :=, so that = is left.
            number = fields.get(f"segment{found[1]}_labelvalue", "=").lstrip("=")
            if number.isdigit():
                names[int(number)] = value.lstrip("=").strip()
    return names
