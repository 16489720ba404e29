"""Structures that a tool must keep clear of, as an argument of `Bone.cut` and `Loop`."""

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Union

import numpy as np
from pydantic import TypeAdapter, ValidationError

from meshes.base.arrays import Array
from meshes.base.errors import InputError, names_of_caller
from meshes.surfaces.surface import surface_from_triangles
from tissue.cutters.cutter import Cutter
from tissue.models.keep_clear import KeepClear, Structure
from tissue.scene.scene import Name
from tissue.simulation.builders.keep_clear import structure_of_file
from tissue.simulation.builders.parts import FILE_WORDS

if TYPE_CHECKING:
    import pyvista

__all__ = ["Structures", "clearance_of", "refuse_structures"]

Structures = Mapping[str, Union[str, PathLike[str], "pyvista.PolyData"]]
"""Closed surface of each structure by name, in millimetres in the frame of the bone.

It is a file or a pyvista surface.
"""


def clearance_of(
    structures: Structures | None,
    tool: Cutter,
    *,
    box_m: Array | None = None,
    times_s: Array | None = None,
) -> KeepClear | None:
    """Build the measurement of a tool's distance from structures; None without any.

    Parameters
    ----------
    box_m, times_s
        As for `tissue.models.keep_clear.KeepClear`.

    Raises
    ------
    InputError
        If a name has characters other than small letters, digits and underscores, or a surface
        cannot be used.
    """
    if not structures:
        return None
    if not isinstance(structures, Mapping):
        raise InputError(
            "keep_clear",
            "be a mapping of names to surfaces",
            f'{type(structures).__name__}: give {{"nerve"',
            '"nerve.stl"}',
        )
    found = {}
    for name, surface in structures.items():
        try:
            TypeAdapter(Name).validate_python(name)
        except ValidationError:
            raise InputError(
                "keep_clear",
                "have names of small letters, digits and underscores",
                f"{name!r}",
                "use one such as facial_nerve",
            ) from None
        with names_of_caller(
            dict.fromkeys((*FILE_WORDS, "anatomy.scale_mm"), f"keep_clear[{name}]")
        ):
            found[name] = _structure(name, surface)
    return KeepClear(tool.profile, found, box_m=box_m, times_s=times_s)


def refuse_structures(structures: Structures | None) -> None:
    """Refuse structures for a tool that presses an organ, since nothing is cut there."""
    if structures:
        raise InputError(
            "keep_clear", "be left out for an organ", "structures", "use it with a cutter in bone"
        )


def _structure(name: str, surface: object) -> Structure:
    """Read one structure."""
    import pyvista

    if isinstance(surface, str | PathLike):
        return structure_of_file(Path(surface), scale_mm=1.0)[0]
    if not isinstance(surface, pyvista.PolyData):
        raise InputError(
            "surface",
            "be a file or a pyvista.PolyData",
            type(surface).__name__,
            "give the path of an STL file",
        )
    triangles = surface.triangulate()
    made = surface_from_triangles(
        np.asarray(triangles.points, dtype=np.float64),
        np.asarray(triangles.regular_faces, dtype=np.int64),
        source=name,
        scale_mm=1.0,
        cut_off=True,
        every_piece=True,
    )
    return Structure(made.vertices_m, made.faces)
