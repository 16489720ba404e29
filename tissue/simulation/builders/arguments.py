"""Validation of arguments and of files of constants, with the rules for the keys of a scene."""

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import ValidationError

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError, enumerated, names_of_caller
from meshes.base.hints import nearest
from meshes.base.text_tables import shown
from meshes.surfaces.glenoid import GLENOID_LAYERS
from meshes.surfaces.surface import Surface, surface_from_triangles
from meshes.surfaces.triangle_files import read_triangles
from meshes.tets.files import require_millimetres
from meshes.tooth.layers import TOOTH_LAYERS
from meshes.vertebra.lumbar import VERTEBRA_LAYERS
from tissue.materials.constants import CUT_AS, Constant, constants, listed
from tissue.materials.scene_constants import Materials
from tissue.scene.anatomy import Tooth
from tissue.scene.load import names_file
from tissue.scene.messages import error_of
from tissue.scene.part import Part, entries
from tissue.scene.registry import ANATOMIES
from tissue.scene.scene import Scene
from tissue.scene.used_constants import Used, used_constants
from tissue.simulation.builders.parts import FILE_WORDS

Table = TypeVar("Table", bound=Part)
LAYERS = (*GLENOID_LAYERS, *VERTEBRA_LAYERS, *TOOTH_LAYERS)
"""Layers of the built-in anatomies.

A file of material constants may name any of these layers, even layers that the scene does not have.
"""
UNUSUAL = 10.0
"""Factor by which a value must lie outside its cited range to make a run question the unit.

The value was chosen by judgement.
"""


def unusual_modulus(key: str, value_kPa: float, cited: Constant, material: str) -> str:
    """Return a note if a modulus is far outside a material's cited range, else an empty text.

    `key` is the key or argument with which the modulus was given.
    """
    if cited.low / UNUSUAL <= value_kPa <= UNUSUAL * cited.high:
        return ""
    return (
        f"Cited moduli of {material} are {cited.low:g} to {cited.high:g} kPa: is {key} = "
        f"{value_kPa:g} in kPa?"
    )


def require_known(options: Mapping[str, object], table: type, *, of: str) -> None:
    """Raise a `TypeError` for an unknown option, as Python does for an unknown argument."""
    known = table.__annotations__
    for name in options:
        if name not in known:
            raise TypeError(
                f"{of} got an unexpected keyword argument {name!r}{nearest(name, known)}. Beyond "
                f"its listed arguments it takes {', '.join(sorted(known))}."
            )


def stated(model: type[Table], values: Mapping[str, object], *, prefix: str = "") -> Table:
    """Return a scene table made from a caller's arguments; None values are left out.

    Error messages show `prefix` before the name of an argument.

    Raises
    ------
    InputError
        If a value is out of range, or a key is unknown.
    """
    given = {name: value for name, value in values.items() if value is not None}
    try:
        return model.model_validate(given)
    except ValidationError as error:
        refusal = error_of(error.errors()[0], given, model)
        refusal.argument = prefix + refusal.argument
        raise refusal from None


def given_note(
    given: Materials, used_constants: Sequence[Used], *, layers: Sequence[str], by: str
) -> dict[str, str]:
    """Return the note ``materials``, which lists the given constants that are used.

    `used_constants` lists the constants that a scene or another object uses; `by` names this object
    in the note.

    If no constants were given, there is no note, and all constants have their built-in values.

    Raises
    ------
    InputError
        If none of the given constants has an effect, a constant is also given in the scene, or a
        layer is unknown.
    """
    if not given.given:
        return {}
    name = Path(given.file).name
    known = dict.fromkeys((*listed("cutting"), *LAYERS, *layers))
    for entry in given.given:
        table, layer, _ = entry.split(".")
        if table == "cutting" and layer not in known:
            raise InputError(
                "materials",
                "have tables [cutting.NAME] only for known materials and layers",
                f"[cutting.{layer}]{nearest(layer, known)} in {name}",
                f"use {enumerated(known, 'or')}",
            )
    used = {one.full: one for one in used_constants if one.full in given.given}
    for full, one in used.items():
        if one.stated is not None:
            part = (
                "organ.young_kPa"
                if one.name == "modulus_kPa"
                else f"{full.split('.')[0]}.{one.name}"
            )
            part = part.replace("soft.", "organ.")
            raise InputError(
                part,
                f"be left out if the file of materials contains {full}",
                shown(one.stated),
                "remove one of the two",
            )
    _require_some(given, used_constants, by=by)
    note = f"of {name}: " + "; ".join(
        f"{full} {one.cited.value:g} ({one.cited.low:g}-{one.cited.high:g}), {one.cited.source}"
        for full, one in used.items()
    )
    note += "".join(_unusual(full, one.cited.value) for full, one in used.items())
    if unused := [full for full in given.given if full not in used]:
        note += f". Not used in this {by}: {', '.join(unused)}"
    return {"materials": note}


def _unusual(full: str, value: float) -> str:
    """Return a sentence if a constant is far outside its built-in range, else an empty text."""
    table, material, name = full.split(".")
    layer_material = CUT_AS.get(material, "bone")
    cited = constants(table, material if material in listed(table) else layer_material)[name]
    # A constant is 0 if an effect is left out, and such a value has no wrong unit.
    is_usual = cited.low / UNUSUAL <= value <= UNUSUAL * cited.high
    if is_usual or value == 0.0 or cited.high == 0.0:
        return ""
    end = "upper" if value > cited.high else "lower"
    ratio = value / (cited.high if value > cited.high else cited.low)
    return (
        f". {full} is {float(f'{ratio:.2g}'):g} times the {end} end of the built-in range "
        f"({cited.low:g}-{cited.high:g}): check its unit"
    )


def require_files(scene: Scene) -> None:
    """Check the files of a scene before its tissue is built.

    The layers of the tissue are not known before it is built. Cutting constants of any layer are
    therefore accepted.

    Raises
    ------
    InputError
        If a file does not exist, or the file of material constants cannot be used.
    """
    for key, value in entries(scene.model_dump(exclude_none=True)):
        if names_file(key) and value and not Path(str(value)).exists():
            raise InputError(key, "exist", value, "check the path")
    given = scene.constants
    # A registered anatomy may have any layers.
    if scene.materials and ANATOMIES[scene.anatomy.kind].build is None:
        layers = TOOTH_LAYERS if isinstance(scene.anatomy, Tooth) else VERTEBRA_LAYERS[:1]
        own = [full.split(".")[1] for full in given.given if full.startswith("cutting.")]
        _require_some(given, used_constants(scene, (*layers, *own)), by="scene")


def _require_some(given: Materials, used: Sequence[Used], *, by: str) -> None:
    """Raise an error if no given constant is in `used`; the error lists these constants."""
    if given.given.keys().isdisjoint(one.full for one in used):
        names = [one.full for one in used if one.stated is None]
        raise InputError(
            "materials",
            f"contain a constant that the {by} uses",
            f"only {enumerated(list(given.given))} in {Path(given.file).name}",
            f"use {enumerated(names, 'or')}; or remove materials",
        )


def surface_of(
    name: str, given: object, scale_mm: float | None, *, is_part: bool = False
) -> Surface:
    """Return a closed surface from a file, a pyvista or trimesh surface, or vertices and triangles.

    If `is_part` is True, all separate pieces of the surface are kept, and the surface may be open
    at the edge of a scan.

    Raises
    ------
    InputError
        If `given` is not a surface, its size suggests another unit than millimetres, or it encloses
        no solid.
    """
    source = name
    words = dict.fromkeys(FILE_WORDS, name)
    # A structure has the unit of the anatomy, and no scale of its own.
    words["anatomy.scale_mm"] = name if is_part else "scale_mm"
    if isinstance(given, str | PathLike):
        source = Path(given).name
        with names_of_caller(words):
            vertices, faces = read_triangles(Path(given))
    else:
        vertices, faces = _triangles(name, given)
    scale = require_millimetres(name, vertices, scale_mm)
    with names_of_caller(words):
        return surface_from_triangles(
            vertices,
            faces,
            source=source,
            scale_mm=scale,
            cut_off=is_part,
            every_piece=is_part,
        )


def _triangles(name: str, given: Any) -> tuple[Array, Ints]:
    """Return vertices and triangles of a surface that is given in memory."""
    if hasattr(given, "is_all_triangles"):  # pyvista
        whole = given.triangulate()
        return np.asarray(whole.points, dtype=np.float64), np.asarray(
            whole.regular_faces, dtype=np.int64
        )
    if hasattr(given, "vertices") and hasattr(given, "faces"):  # trimesh
        given = given.vertices, given.faces
    if isinstance(given, Sequence) and len(given) == 2:
        vertices, faces = (np.asarray(each) for each in given)
        if vertices.ndim == faces.ndim == 2 and vertices.shape[1] == faces.shape[1] == 3:
            return vertices.astype(np.float64), faces.astype(np.int64)
    raise InputError(
        name,
        "be a closed surface of pyvista or trimesh, a pair (vertices, triangles) or a file name",
        f"the type {type(given).__name__}",
        "export the surface as STL and give the name of this file",
    )
