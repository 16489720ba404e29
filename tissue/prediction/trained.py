"""Trained predictors of a scene, and their file: arrays and one line of JSON, without any code."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any
from zipfile import is_zipfile

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import DamagedFileError, InputError
from meshes.base.file_limits import read_npz
from meshes.base.text_tables import read_json
from meshes.base.whole_file import package_version, require_new_file, require_version, whole_file
from tissue.prediction.operator import (
    Delays,
    Dictionary,
    GapProducts,
    Identity,
    Operator,
    Polynomials,
)

__all__ = ["VALIDATED_AT", "Trained", "from_plain", "is_trained", "shipped_file", "to_plain"]

SHIPPED = Path(__file__).parent / "trained"
"""Folder of the predictors that ship with the engine, one file a scene."""
VALIDATED_AT = 6
"""Lead in whole ticks at which predictors are compared in training.

It is the lead for 4 ms of latency, which is 6.11 ticks on a touch with its path to the motor, see
`tissue.simulation.builders.loop.lead_ticks`.
"""
FORMAT = "tissue predictor"
VERSION = 3
"""Version of the file. Files of version 2 hold further arrays, which `read` leaves out."""
ROUNDED = ("A", "B")
EXACT = ("offset", "middle", "scale")
"""Arrays of an operator that a file holds in single and in double precision."""
KINDS: dict[object, Callable[..., Dictionary]] = {
    kind.__name__: kind for kind in (Identity, Polynomials, GapProducts, Delays)
}


@dataclass(frozen=True)
class Trained:
    """Predictors trained on a scene.

    Attributes
    ----------
    scene
        Name of the scene.
    operator
        Operator of the lifted predictors, on displacement and stretch of an axis [m], see
        `tissue.prediction.koopman`.
    control
        Operator of linear dynamic mode decomposition; states are the force, inputs position and
        velocity of the device.
    growth
        Mean square of the scaled windows above which the operator is outside its training range.
    fallback
        Name of the predictor used outside the training range: the best predictor without an
        operator.
    facts
        Numbers and names that describe training and validation.
    """

    scene: str
    operator: Operator
    control: Operator
    growth: float
    fallback: str = "hold"
    facts: dict[str, Any] = field(default_factory=dict)

    def loses(self, kind: str) -> bool:
        """Return True if the zero-order hold had a smaller error than a predictor in validation.

        The errors are compared at the validated horizon nearest to a loop's usual lead.
        """
        if "validation" not in self.facts:
            return False
        errors = self.facts["validation"]["errors"]
        horizons = np.array(self.facts["validation"]["horizons_ms"])
        at = int(np.abs(horizons - VALIDATED_AT).argmin())
        return bool(errors[kind][at] > errors["hold"][at])

    def write(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the predictors to a file, which appears completely or not at all.

        The matrices are written in single precision, which keeps the file small.

        Raises
        ------
        InputError
            If the file exists and may not be written over, or its folder is missing.
        """
        path = Path(path)
        require_new_file(path, overwrite=overwrite)
        if not path.parent.is_dir():
            raise InputError("file", "lie in a folder that exists", path, f"create {path.parent}")
        stored: dict[str, Any] = {}
        described = {}
        for name, operator in (("lifted", self.operator), ("control", self.control)):
            described[name] = {
                "dictionary": to_plain(operator.dictionary),
                "step_s": operator.step_s,
            }
            for key in ROUNDED:
                stored[f"{name}.{key}"] = getattr(operator, key).astype(np.float32).astype(float)
            for key in EXACT:
                stored[f"{name}.{key}"] = getattr(operator, key)
        whole = {
            "format": FORMAT,
            "version": VERSION,
            "tissue": package_version(),
            "scene": self.scene,
            "operators": described,
            "header": {"growth": self.growth, "fallback": self.fallback, "facts": self.facts},
        }
        line = np.array(json.dumps(whole, allow_nan=False))
        with whole_file(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, json=line, **stored)
        return path

    @classmethod
    def read(cls, path: str | Path, *, scene: str | None = None) -> "Trained":
        """Read the trained predictors of a scene; no code in the file is run.

        Raises
        ------
        InputError
            If the file is missing, damaged, of another version, or of another scene than the given
            one.
        """
        path = Path(path)
        what = "predictor file"
        if not path.is_file():
            raise InputError(what, "be an existing file", path, "train it with 'tissue train'")
        again = f"train it again with 'tissue train {scene or 'SCENE'}'"
        if not is_zipfile(path):  # NumPy would read it as a pickle
            raise InputError(what, "be whole and one that 'tissue train' wrote", path, again)
        try:
            held = read_npz(path)
            whole = read_json(str(held.pop("json")))
            if not isinstance(whole, dict) or whole.get("format") != FORMAT:
                raise InputError(what, "be one that 'tissue train' wrote", path, again)
            require_version(what, whole, VERSION, key="version", where=path, remedy=again)
            if scene is not None and whole["scene"] != scene:
                raise InputError(what, f"be of scene {scene}", f"{whole['scene']} in {path}", again)
            lifted, control = (
                _operator(name, whole["operators"][name], held) for name in ("lifted", "control")
            )
            header = whole["header"]
            growth = float(header["growth"])
            return cls(whole["scene"], lifted, control, growth, header["fallback"], header["facts"])
        except InputError:
            raise
        except Exception as problem:  # a damaged archive raises many kinds of errors
            found = problem if isinstance(problem, DamagedFileError) else "it is damaged"
            raise InputError(what, "be whole", f"{path} ({found})", again) from problem


def shipped_file(scene: str) -> Path:
    """Return the path of the predictor of a built-in scene.

    Raises
    ------
    InputError
        If the scene has no built-in predictor.
    """
    path = SHIPPED / f"{scene}.npz"
    if not path.is_file():
        known = ", ".join(sorted(each.stem for each in SHIPPED.glob("*.npz")))
        raise InputError(
            "coupling.predictor_file",
            f"be given for a scene other than {known}",
            f"nothing for {scene}",
            f"write one with 'tissue train {scene} --out FILE'",
        )
    return path


def is_trained(scene: str, file: str = "") -> bool:
    """Return True if a trained predictor is known for a scene.

    It is the scene's own file, or one that ships with the engine.
    """
    return bool(file) or (SHIPPED / f"{scene}.npz").is_file()


def _operator(name: str, plain: Mapping[str, Any], arrays: Mapping[str, Any]) -> Operator:
    """Return one operator of a file after checking its shapes and numbers."""
    given: dict[str, Array] = {key: arrays[f"{name}.{key}"] for key in (*ROUNDED, *EXACT)}
    count = len(given["offset"])
    inputs = given["B"].shape[-1]
    shapes = {"A": (count, count), "B": (count, inputs), "middle": (count,), "scale": (count,)}
    for key, each in given.items():
        if each.dtype != np.float64 or not np.isfinite(each).all():
            raise DamagedFileError(f"{name}.{key} is not finite")
        if each.shape != shapes.get(key, (count,)):
            raise DamagedFileError(f"{name}.{key} has shape {each.shape}")
    operator = Operator(
        dictionary=from_plain(plain["dictionary"]),
        A=given["A"],
        B=given["B"],
        offset=given["offset"],
        middle=given["middle"],
        scale=given["scale"],
        step_s=float(plain["step_s"]),
    )
    # The state size follows from the number of observables, and is 0 where no size fits them.
    if not operator.state_size:
        raise DamagedFileError(f"{name} has {count} observables")
    return operator


def to_plain(dictionary: Dictionary) -> dict[str, object]:
    """Return the dictionary as names, numbers and lists, for a file."""
    plain: dict[str, object] = {"kind": type(dictionary).__name__}
    for entry in fields(dictionary):  # type: ignore[arg-type]
        value = getattr(dictionary, entry.name)
        plain[entry.name] = to_plain(value) if isinstance(value, Dictionary) else value
    return plain


def from_plain(plain: Mapping[str, object]) -> Dictionary:
    """Return the dictionary that `to_plain` described.

    Raises
    ------
    InputError
        If the kind or one of its fields is unknown, or a value cannot be used.
    """
    given = {name: _frozen(value) for name, value in plain.items()}
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
