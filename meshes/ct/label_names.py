"""Names of labels, read from sets of known programs, from a user's table or from file headers."""

import re
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path

from meshes.base.errors import InputError, enumerated, require_file
from meshes.base.text_tables import read_toml
from meshes.images.data import first_bytes
from meshes.images.text_headers import header_lines

MOST_LABELS = 2**31 - 1
"""Largest valid label number."""
_HEADER_BYTES = 1 << 20
"""Number of bytes of a NIfTI file that are searched for a label table.

The value allows 4 kB for each of 255 names.
"""
_XML_NAME = re.compile(r'<Label Key="(\d+)"[^>]*>\s*<!\[CDATA\[(.*?)\]\]>', re.DOTALL)
"""Regular expression for a label in a NIfTI header extension (Caret, TotalSegmentator)."""
_SIDES = ("left", "right")


@dataclass(frozen=True)
class Segment:
    """Labelled structure in a segmentation.

    Attributes
    ----------
    number, name
        Label number and name.
    side
        ``left`` or ``right`` if the file states the body side separately from the name, else an
        empty string.
    layer, value
        Index of the layer that contains the segment, and value of the segment in this layer. A file
        has several layers if segments overlap.
    """

    number: int
    name: str
    side: str = ""
    layer: int = 0
    value: int = 1


def apart(segments: Sequence[Segment]) -> dict[int, str]:
    """Return a dictionary from segment number to name.

    If several segments have the same name, the body side from the file is appended to this name.
    """
    counts = Counter(each.name for each in segments)
    return {
        each.number: f"{each.name}_{each.side}"
        if counts[each.name] > 1 and each.side
        else each.name
        for each in segments
    }


def side_of(text: str) -> str:
    """Return ``left`` or ``right`` if the text is one of these words, else an empty string."""
    word = text.strip().lower()
    return word if word in _SIDES else ""


@cache
def label_sets() -> dict[str, dict[int, str]]:
    """Return, for each known segmentation program, a dictionary from label number to name."""
    table = tomllib.loads(files("meshes.ct").joinpath("label_sets.toml").read_text("utf-8"))
    return {
        name: dict(zip(entry.get("numbers", range(1, 256)), entry["names"], strict=False))
        for name, entry in table.items()
    }


def given_names(names: str | Path) -> Mapping[int, str]:
    """Return a dictionary from label number to name, for a known program or from a TOML file.

    Raises
    ------
    InputError
        If `names` is not a known program or TOML file, or if a number is not valid.
    """
    if str(names) in label_sets():
        return label_sets()[str(names)]
    file = Path(names)
    if file.suffix != ".toml":
        raise InputError(
            "names",
            f"be one of {', '.join(label_sets())} or a TOML file",
            names,
            "write a TOML file with a table [labels] and lines such as cortical = 1",
        )
    require_file(file, "names of labels")
    try:
        table = read_toml(file.read_text("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as problem:
        raise InputError(
            "names",
            "be a readable TOML file",
            f"{file.name} with the error {str(problem)!r}",
            "correct the file",
        ) from problem
    labels = table.get("labels")
    if not isinstance(labels, dict):
        labels = {}
    numbers = list(labels.values())
    whole = all(type(number) is int and 1 <= number <= MOST_LABELS for number in numbers)
    if set(table) != {"labels"} or not whole or not 0 < len(numbers) == len(set(numbers)):
        found = enumerated(numbers) or "no labels"
        if len(table) > 1:
            found = f"the keys {enumerated(table)}"
        raise InputError(
            "names",
            f"be one table [labels] with a different number from 1 to {MOST_LABELS} for each name",
            f"{found} in {file.name}",
            "write [labels] and a line such as cortical = 1",
        )
    return {number: name for name, number in labels.items()}


def header_names(path: Path) -> dict[int, str]:
    """Read the dictionary from label number to name in an image's header."""
    name = path.name.lower()
    if name.endswith((".nii", ".nii.gz")):
        text = first_bytes(path, _HEADER_BYTES).decode("latin-1")
        return {int(number): label.strip() for number, label in _XML_NAME.findall(text)}
    return apart(slicer_segments(path))


def slicer_segments(path: Path) -> list[Segment]:
    """Return the segments that 3D Slicer listed in the header of a NRRD file.

    In a file with several layers, two segments may have the same value. The segments of such a file
    are therefore numbered from 1.
    """
    if not path.name.lower().endswith((".nrrd", ".nhdr")):
        return []
    fields, _ = header_lines(path, ":", "")
    is_layered = fields.get("dimension") == "4"
    indices = (re.fullmatch(r"segment(\d+)_name", key) for key in fields)
    found: list[Segment] = []
    for index in sorted(int(each[1]) for each in indices if each):
        # In NRRD files, := separates such keys from their values, so the value begins with =.
        keys = ("name", "labelvalue", "layer", "tags")
        name, value, layer, tags = (
            fields.get(f"segment{index}_{key}", "").lstrip("=").strip() for key in keys
        )
        # 3D Slicer 4 wrote one layer for each segment, without the numbers of layer and label.
        if is_layered:
            at = int(layer) if layer.isdigit() else index
            label = int(value) if value.isdigit() else 1
            found.append(Segment(len(found) + 1, name, _slicer_side(tags), at, label))
        elif value.isdigit():
            found.append(Segment(int(value), name, _slicer_side(tags), 0, int(value)))
    return found


def _slicer_side(tags: str) -> str:
    """Return the body side that the terminology of a 3D Slicer segment states.

    The terminology is a text with parts that are separated by ~. The first four parts are the name
    of a list, the category, the type and the modifier.
    """
    entry = re.search(r"TerminologyEntry:([^|]*)", tags)
    parts = entry[1].split("~") if entry else []
    return side_of(parts[3].rpartition("^")[2]) if len(parts) > 3 else ""


def shared_names(names: Mapping[int, str], source: str) -> list[str]:
    """Return a note for each name that is used by several labels."""
    numbers: dict[str, list[int]] = {}
    for number, name in names.items():
        numbers.setdefault(name, []).append(number)
    return [
        f"{source} has {len(each)} labels named {name} ({', '.join(map(str, each))}): "
        "they are taken as one."
        for name, each in numbers.items()
        if len(each) > 1
    ]
