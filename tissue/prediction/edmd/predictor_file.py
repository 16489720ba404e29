"""Operators in a file: arrays and one line of JSON in an npz archive, without any code."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any
from zipfile import is_zipfile

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import DamagedFileError, InputError
from meshes.base.file_limits import read_npz
from meshes.base.text_tables import read_json
from meshes.base.whole_file import package_version, require_version, whole_file
from tissue.prediction.edmd.dictionary import (
    Delays,
    Dictionary,
    GapProducts,
    Gaussians,
    Identity,
    Polynomials,
    ThinPlates,
)
from tissue.prediction.edmd.lifted import FitStatistics, Operator
from tissue.system.outputs import require_new_file

__all__ = [
    "VERSION",
    "StoredPredictor",
    "from_plain",
    "read_predictor",
    "to_plain",
    "write_predictor",
]

FORMAT = "tissue predictor"
VERSION = 2
ARRAYS = ("A", "B", "offset", "middle", "scale", "input_middle", "input_scale", "moments")
BOX = ("lowest", "highest")
"""Arrays of an operator, and arrays of its training range, that a file keeps."""
KINDS: dict[object, Callable[..., Dictionary]] = {
    kind.__name__: kind
    for kind in (Identity, Polynomials, Gaussians, ThinPlates, GapProducts, Delays)
}


@dataclass(frozen=True)
class StoredPredictor:
    """Contents of a predictor file.

    Attributes
    ----------
    scene
        Name of the scene that it was trained on.
    operators
        Operators by name.
    header
        Additional numbers and names, as passed to the writer.
    arrays
        Additional arrays, as passed to the writer.
    """

    scene: str
    operators: dict[str, Operator]
    header: dict[str, Any]
    arrays: dict[str, Array]


def write_predictor(
    path: str | Path,
    operators: Mapping[str, Operator],
    *,
    scene: str,
    header: Mapping[str, Any],
    arrays: Mapping[str, Array] | None = None,
    overwrite: bool = False,
) -> Path:
    """Write operators and their data to one file; it appears completely or not at all.

    Parameters
    ----------
    path
        File to write, its folder existing.
    operators
        Operators by name, such as one for each contact mode.
    scene
        Name of the scene that they were trained on.
    header
        Values that JSON can hold: horizons, gains, validation errors.
    arrays
        Further arrays of numbers by name.
    overwrite
        Replace an existing file.

    Raises
    ------
    InputError
        If the file exists and may not be replaced, or its folder is missing.
    """
    path = Path(path)
    require_new_file(path, overwrite=overwrite)
    if not path.parent.is_dir():
        raise InputError("file", "lie in a folder that exists", path, f"create {path.parent}")
    stored: dict[str, Array] = {
        f"further.{name}": np.asarray(each, float) for name, each in (arrays or {}).items()
    }
    described = {}
    for name, operator in operators.items():
        described[name] = {
            "dictionary": to_plain(operator.dictionary),
            "step_s": operator.step_s,
            "statistics": vars(operator.statistics)
            | {"residual_rms": operator.statistics.residual_rms.tolist()},
        }
        stored |= {f"{name}.{each}": getattr(operator, each) for each in ARRAYS}
        stored |= {f"{name}.training.{each}": getattr(operator, each) for each in BOX}
    whole = {"format": FORMAT, "version": VERSION, "tissue": package_version(), "scene": scene}
    whole |= {"operators": described, "header": dict(header)}
    line = np.array(json.dumps(whole, allow_nan=False))
    with whole_file(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, json=line, **stored)
    return path


def read_predictor(path: str | Path, *, scene: str | None = None) -> StoredPredictor:
    """Read a file of `write_predictor`; no code in the file is run.

    Raises
    ------
    InputError
        If the file is missing, damaged, of another version, or of another scene than the given one.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(
            "predictor file", "be an existing file", path, "train it with 'tissue train'"
        )
    again = f"train it again with 'tissue train {scene or 'SCENE'}'"
    if not is_zipfile(path):  # NumPy would read it as a pickle
        raise InputError(
            "predictor file", "be whole and one that 'tissue train' wrote", path, again
        )
    try:
        held = read_npz(path)
        whole = read_json(str(held["json"]))
        if not isinstance(whole, dict) or whole.get("format") != FORMAT:
            raise InputError("predictor file", "be one that 'tissue train' wrote", path, again)
        require_version("predictor file", whole, VERSION, key="version", where=path, remedy=again)
        if scene is not None and whole["scene"] != scene:
            raise InputError(
                "predictor file", f"be of scene {scene}", f"{whole['scene']} in {path}", again
            )
        arrays: dict[str, Any] = {name: each for name, each in held.items() if name != "json"}
        operators = {
            name: _operator(name, each, arrays) for name, each in whole["operators"].items()
        }
    except InputError:
        raise
    except Exception as problem:  # a damaged archive raises many kinds of errors, also zlib's own
        found = problem if isinstance(problem, DamagedFileError) else "it is damaged"
        raise InputError("predictor file", "be whole", f"{path} ({found})", again) from problem
    further = {
        name.removeprefix("further."): each
        for name, each in arrays.items()
        if name.startswith("further.")
    }
    return StoredPredictor(whole["scene"], operators, whole["header"], further)


def _operator(name: str, plain: Mapping[str, Any], arrays: Mapping[str, Array]) -> Operator:
    """Return one operator after checking its shapes and numbers."""
    for key, each in arrays.items():
        if each.dtype != np.float64 or not np.isfinite(each).all():
            raise DamagedFileError(f"{key} is not finite")
    given = {key: arrays[f"{name}.{key}"] for key in ARRAYS}
    dictionary = from_plain(plain["dictionary"])
    given |= {key: arrays[f"{name}.training.{key}"] for key in BOX}
    count = dictionary.size(len(given["lowest"]))
    inputs = len(given["input_scale"])
    shapes = {
        "A": (count, count),
        "B": (count, inputs),
        "offset": (count,),
        "middle": (count,),
        "scale": (count,),
    }
    shapes |= {"input_middle": (inputs,), "highest": given["lowest"].shape}
    for key, shape in shapes.items():
        if given[key].shape != shape:
            raise DamagedFileError(f"{name}.{key} has shape {given[key].shape} instead of {shape}")
    statistics = plain["statistics"] | {
        "residual_rms": np.array(plain["statistics"]["residual_rms"])
    }
    return Operator(
        dictionary=dictionary,
        **given,
        statistics=FitStatistics(**statistics),
        step_s=float(plain["step_s"]),
    )


def to_plain(dictionary: Dictionary) -> dict[str, object]:
    """Return the dictionary as names, numbers and lists, for a file."""
    given = {field.name: getattr(dictionary, field.name) for field in fields(dictionary)}  # type: ignore[arg-type]
    plain = {
        name: to_plain(value) if isinstance(value, Dictionary) else value
        for name, value in given.items()
    }
    return {"kind": type(dictionary).__name__} | plain


def from_plain(plain: Mapping[str, object]) -> Dictionary:
    """Return the dictionary that `to_plain` described; empty lists keep their defaults.

    Raises
    ------
    InputError
        If the kind or one of its fields is unknown, or a value cannot be used.
    """
    given = {name: _frozen(value) for name, value in plain.items() if value != []}
    kind = given.pop("kind", None)
    if kind not in KINDS:
        raise InputError(
            "kind", f"be one of {', '.join(map(str, KINDS))}", kind, "train the predictor again"
        )
    try:
        return KINDS[kind](**given)
    except TypeError as problem:
        raise InputError(
            kind, "have the fields of this version", problem, "train it again"
        ) from None


def _frozen(value: object) -> object:
    """Convert lists to tuples, and descriptions to dictionaries of observables."""
    if isinstance(value, Mapping):
        return from_plain(value)
    return tuple(_frozen(each) for each in value) if isinstance(value, list) else value
