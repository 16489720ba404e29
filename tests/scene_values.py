"""Another valid value for each key that a scene of some kind can be given."""

from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt

from tissue.scene.anatomy import Part
from tissue.scene.coupling import Fidelity
from tissue.scene.scene import Scene, Stress

VALUES = {
    "name": "needle",
    "voxels.spacing_mm": 0.2,
    "voxels.margin_mm": 4.0,
    "perception": "population",
    "anatomy.centre_mm": [13.0, 8.0, 6.0],
    "tool.spin_rpm": 900.0,
    "tool.peg_diameter_mm": 2.0,
    "organ.friction": 0.05,
    "anatomy.along": [0.6, 0.8, 0.0],
    "stress.cell_mm": 1.0,
}
"""Values that fit every kind and reach something there."""
LAYERS = ("enamel", "dentin", "pulp", "ligament")


def keys_of(table: dict[str, Any]) -> list[str]:
    """Every dotted key that a scene of this kind can be given, kinds of its parts left out."""
    scene = Scene.model_validate(table)
    found = []
    for name in Scene.model_fields:
        value = getattr(scene, name)
        part = type(value) if isinstance(value, Part) else {"stress": Stress, "fidelity": Fidelity}.get(name)
        found += [name] if part is None else [f"{name}.{each}" for each in part.model_fields if each != "kind"]
    return found


def changes(table: dict[str, Any], key: str, files: dict[str, str]) -> dict[str, Any]:
    """Another valid value of a key, by its key, and what a file of its kind needs beside it."""
    part, _, name = key.partition(".")
    if part == "anatomy" and name.endswith("_file"):
        layers = {f"anatomy.{layer}_file": files[layer] for layer in LAYERS}
        return layers | {key: files[f"other {name.removesuffix('_file')}"]}
    if key == "anatomy.file":
        # Labels name neither ligament nor bone, so that no stress could be computed.
        return _other_anatomy(table["anatomy"], files) | ({"stress": None} if "stress" in table else {})
    if key == "anatomy.nodule_diameter_mm":
        liver = table["anatomy"]["kind"] == "liver"
        diameter, centre = (37.0, [-15.0, -5.0, -60.0]) if liver else (13.0, [0.0, 0.0, -13.0])
        return {key: diameter, "anatomy.nodule_centre_mm": centre}  # a centre alone has no effect
    named: dict[str, Any] = {
        "device": "omni" if table.get("device", "none") != "none" else "touch",  # a tool that stands still needs one
        "tool.file": files["other finger"],
        "motion.file": files["other poses"],
        "coupling.predictor_file": files["other predictor"],
        "anatomy.held_part": "2",
        "organ.nodule_part": "body" if table["anatomy"].get("file", "").endswith(".stl") else "1",
        "anatomy.spacing_mm": 0.3 if table["anatomy"]["kind"] == "molar" else 0.9,
        "anatomy.edge_mm": 0.85 * table["anatomy"].get("edge_mm", 20.0),
    }
    if table["anatomy"]["kind"] == "liver":
        named["anatomy.centre_mm"] = [6.0, 3.0, 30.0]
    if "stress" in table:
        named["voxels.spacing_mm"] = 0.125
    return {key: named[key] if key in named else another(table, key)}


def _other_anatomy(anatomy: dict[str, Any], files: dict[str, str]) -> dict[str, Any]:
    """Another file of the kind that an anatomy has or could have, with its place where it needs one."""
    kind = {"block": "bone", "glenoid": "bone", "molar": "labels", "liver": "organ"}[anatomy["kind"]]
    if kind == "bone" and anatomy.get("file", "").endswith(".vti"):
        kind = "image"
    if kind == "organ" and anatomy.get("file", "").endswith(".vtu"):
        kind = "tets"
    found: dict[str, Any] = {"anatomy.file": files[f"other {kind}"]}
    if kind == "bone" and "file" not in anatomy:
        found |= {"anatomy.centre_mm": [0.0, 0.0, 7.0], "anatomy.normal": [0.0, 0.0, 1.0]}
    return found


def another(table: dict[str, Any], key: str) -> Any:
    """Another valid value of a key, from its type, its bounds and the value that it has."""
    if key in VALUES:
        return VALUES[key]
    *parents, name = key.split(".")
    scene = Scene.model_validate(table)
    part: Any = getattr(scene, parents[0]) if parents else scene
    if part is None:
        part = {"stress": Stress(), "fidelity": Fidelity(force_error=0.05)}[parents[0]]
    field, value = type(part).model_fields[name], getattr(part, name)
    kind = _plain(field.annotation)
    if value is None:
        value = field.examples[0] if field.examples else None
        if kind is not float and value is not None and kind is not int:
            return _listed(value)
    if get_origin(kind) is Literal:
        return next(choice for choice in get_args(kind) if choice != value)
    if kind is bool:
        return not value
    if kind in (float, int):
        return _moved(value, kind, field.metadata)
    if name == "points_mm":
        return [[1.1 * each for each in point] for point in value]
    if isinstance(value, tuple):
        return [1.1 * each + 0.1 * (i + 1) for i, each in enumerate(value)]
    return f"{value}-other"


def _moved(value: Any, kind: type, metadata: list[Any]) -> Any:
    """A number that differs from a value and keeps its bounds."""
    low = max(
        [each.ge for each in metadata if isinstance(each, Ge)] + [each.gt for each in metadata if isinstance(each, Gt)],
        default=-1e9,
    )
    high = min(
        [each.le for each in metadata if isinstance(each, Le)] + [each.lt for each in metadata if isinstance(each, Lt)],
        default=1e9,
    )
    number = value if value is not None else 0.5 * (low + high)
    for moved in (1.5 * number, 0.7 * number, number + 0.3, number + 1, low + 0.4 * (high - low)):
        moved = round(moved) if kind is int else float(moved)
        if low < moved < high and moved != value:
            return moved
    raise AssertionError(f"no other value between {low} and {high}")


def _plain(annotation: Any) -> Any:
    """The type that an annotation allows beside nothing."""
    if get_origin(annotation) is Annotated:
        return _plain(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return _plain(next(each for each in get_args(annotation) if each is not type(None)))
    return annotation


def _listed(value: Any) -> Any:
    """A value as TOML has it."""
    return [_listed(each) for each in value] if isinstance(value, tuple) else value
