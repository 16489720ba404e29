"""Labels that the tool must not touch: the surface of each, under a name that a scene can have."""

import re
import unicodedata
from collections.abc import Sequence

from meshes.base.errors import InputError, names_of_caller
from meshes.base.progress import Progress
from meshes.ct.kept_label import kept_label
from meshes.ct.labels import Labels
from meshes.surfaces.surface import Surface, surface_from_triangles
from tissue.importing.request import ImportRequest

__all__ = ["kept_clear", "plain_names"]

LONGEST = 60
"""Letters of a name, which is part of a file's name."""


def kept_clear(request: ImportRequest, labels: Labels | None, report: Progress) -> tuple[dict[str, Surface], list[str]]:
    """Surfaces of the labels that the tool must not touch, all pieces of each, by plain name, and what to know of them.

    Raises
    ------
    InputError
        If there is no such label, it is named twice, or nothing of it is in the image.
    """
    if labels is None or not request.keep_clear:
        return {}, []
    with names_of_caller({"label": "keep_clear"}):
        numbers = [labels.number(name) for name in request.keep_clear]
    wanted = [labels.names[number] for number in numbers]
    if len(set(numbers)) < len(numbers):
        raise InputError(f"keep_clear must name each label once, got {', '.join(request.keep_clear)}: leave one out")
    found: dict[str, Surface] = {}
    sentences = []
    for name, plain in zip(wanted, plain_names(wanted), strict=True):
        report(f"finding {name}", 0.0)
        (vertices, faces), notes = kept_label(labels.image, labels.mask(name), name)
        with names_of_caller({"anatomy.scale_mm": f"keep_clear {name}"}):
            found[plain] = surface_from_triangles(
                vertices, faces, source=name, scale_mm=1.0, cut_off=True, every_piece=True
            )
        sentences += [f"keep clear: {name}{'' if plain == name else f', called {plain} in the scene'}", *notes]
    return found, sentences


def plain_names(names: Sequence[str]) -> list[str]:
    """Names of labels as a scene can have them: plain letters, digits and underscores, each name once."""
    taken: list[str] = []
    for name in names:
        letters = unicodedata.normalize("NFKD", name.casefold()).encode("ascii", "ignore").decode().lower()
        first = re.sub("[^a-z0-9]+", "_", letters).strip("_")[:LONGEST] or "structure"
        number, plain = 1, first
        while plain in taken:
            number += 1
            plain = f"{first}_{number}"
        taken.append(plain)
    return taken
