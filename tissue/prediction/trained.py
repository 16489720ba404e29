"""Trained predictors of a scene, and reading and writing of their file."""

import json
from dataclasses import dataclass, field, replace
from functools import cache
from math import inf
from pathlib import Path
from typing import Any
from zipfile import is_zipfile

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import DamagedFileError, InputError, enumerated
from meshes.base.file_limits import read_npz
from meshes.base.text_tables import read_json
from meshes.base.whole_file import package_version, require_new_file, require_version, whole_file
from tissue.prediction.delays import COORDINATES, DELAYS, HORIZON, DelayOperator, Moments

SHIPPED = Path(__file__).parent / "trained"
"""Folder of the predictors that are part of the package, one file for each scene."""
VALIDATED_AT = 6
"""Prediction horizon at which predictors are compared in training [ticks].

The value corresponds to a latency of 4 ms. On a Touch, the horizon for this latency and for the
path to the motor is 6.11 ticks; see `tissue.simulation.builders.loop.lead_ticks`.
"""
FINE_STEP_M = 1e-5
"""Encoder step of the second operator, `Trained.fine` [m].

The value is the smallest encoder step for which prediction errors were measured. The second
operator is also used for smaller steps.
"""
FORMAT = "tissue predictor"
VERSION = 5
"""Version of the file format."""
SHAPES = {"coordinates": (COORDINATES, COORDINATES), "targets": (COORDINATES, 2 * HORIZON)}
"""Shapes of the arrays in a file, keyed by the attributes of `tissue.prediction.delays.Moments`."""


@dataclass(frozen=True)
class Trained:
    """Predictor data obtained by training on runs of a scene.

    Attributes
    ----------
    scene
        Name of the scene.
    operator
        Delay operator that predicts displacement and stretch along one axis [m], see
        `tissue.prediction.delays`.
    step_m
        Encoder step of the devices on which the operator was trained [m].
    fine
        Second operator, trained on the same runs with encoder steps of `FINE_STEP_M`. None if
        `step_m` is not larger than `FINE_STEP_M`.
    fallback
        Name of the predictor that is used outside the training range. In training, this predictor
        was the best one without an operator.
    facts
        Dict with numbers and names that describe the training and the validation.
    """

    scene: str
    operator: DelayOperator
    step_m: float = FINE_STEP_M
    fine: DelayOperator | None = None
    fallback: str = "hold"
    facts: dict[str, Any] = field(default_factory=dict)

    def at_step(self, step_m: float) -> "Trained":
        """Return the trained predictors for a device with another encoder step [m].

        The moments of `operator` and `fine` are interpolated linearly over the encoder step q. The
        reason is that a displacement d shorter than q is read as q with a probability of d / q. The
        mean square of the reading, d q, is therefore linear in q. Outside the range of the two
        operators, the nearest operator is used.
        """
        fine = self.fine
        if fine is None or step_m >= self.step_m:
            return self
        step_m = max(step_m, FINE_STEP_M)
        share = (step_m - FINE_STEP_M) / (self.step_m - FINE_STEP_M)
        own = self.operator.moments
        moments = Moments(
            share * own.coordinates + (1.0 - share) * fine.moments.coordinates,
            share * own.targets + (1.0 - share) * fine.moments.targets,
        )
        growth = max(self.operator.growth, fine.growth)
        return replace(self, operator=DelayOperator(moments, growth), step_m=step_m, fine=None)

    def loses(self, kind: str, other: str) -> bool:
        """Return True if ``other`` had a smaller error than ``kind`` in validation.

        The errors are compared at the validated prediction horizon that is nearest to the usual
        horizon of a haptic loop.
        """
        if "validation" not in self.facts:
            return False
        errors = self.facts["validation"]["errors"]
        horizons = np.array(self.facts["validation"]["horizons_ms"])
        at = int(np.abs(horizons - VALIDATED_AT).argmin())
        return bool(errors[kind][at] > errors[other][at])

    def write(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the predictors to a file.

        The file appears under its name only when it is complete.

        Raises
        ------
        InputError
            If the file exists and must not be overwritten, or if its folder is missing.
        """
        path = Path(path)
        require_new_file(path, overwrite=overwrite)
        if not path.parent.is_dir():
            raise InputError("file", "lie in a folder that exists", path, f"create {path.parent}")
        operators = {"": self.operator} | ({"fine_": self.fine} if self.fine else {})
        stored = {
            prefix + key: getattr(each.moments, key)
            for prefix, each in operators.items()
            for key in SHAPES
        }
        whole = {
            "format": FORMAT,
            "version": VERSION,
            "tissue": package_version(),
            "scene": self.scene,
            "delays": DELAYS,
            "header": {
                "growth": {prefix: each.growth for prefix, each in operators.items()},
                "step_m": self.step_m,
                "fallback": self.fallback,
                "facts": self.facts,
            },
        }
        line = np.array(json.dumps(whole, allow_nan=False))
        with whole_file(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, json=line, **stored)
        return path

    @classmethod
    def read(cls, path: str | Path, *, scene: str | None = None) -> "Trained":
        """Read the trained predictors of a scene, without running code from the file.

        Raises
        ------
        InputError
            If the file is missing or damaged, has another version, or belongs to another scene.
        """
        path = Path(path)
        what = "predictor file"
        if not path.is_file():
            raise InputError(what, "be an existing file", path, "train it with 'tissue train'")
        again = f"train it again with 'tissue train {scene or 'SCENE'}'"
        if not is_zipfile(path):  # NumPy would read it as a pickle
            raise InputError(what, "be a complete file that 'tissue train' wrote", path, again)
        try:
            held = read_npz(path)
            whole = read_json(str(held.pop("json")))
            if not isinstance(whole, dict) or whole.get("format") != FORMAT:
                raise InputError(what, "be a file that 'tissue train' wrote", path, again)
            stated = require_version(what, whole, VERSION, key="version", where=path, remedy=again)
            if stated < VERSION:
                raise InputError(
                    what, f"be of version {VERSION}", f"version {stated} in {path}", again
                )
            if scene is not None and whole["scene"] != scene:
                raise InputError(
                    what,
                    f"be trained for the scene {scene}",
                    f"a predictor for {whole['scene']} in {path}",
                    again,
                )
            if tuple(whole["delays"]) != DELAYS:
                raise InputError(what, "have the delays of this version of tissue", path, again)
            header = whole["header"]
            operators = {
                prefix: DelayOperator(
                    Moments(**{key: _checked(key, held[prefix + key]) for key in SHAPES}),
                    float(growth),
                )
                for prefix, growth in header["growth"].items()
            }
            return cls(
                whole["scene"],
                operators[""],
                float(header["step_m"]),
                operators.get("fine_"),
                header["fallback"],
                header["facts"],
            )
        except InputError:
            raise
        except Exception as problem:  # a damaged archive raises many kinds of errors
            found = problem if isinstance(problem, DamagedFileError) else "it is damaged"
            raise InputError(what, "be complete", f"{path} ({found})", again) from problem


def shipped_file(scene: str) -> Path:
    """Return the path of the file with the trained predictors of a built-in scene.

    Raises
    ------
    InputError
        If the package contains no trained predictors for the scene.
    """
    path = SHIPPED / f"{scene}.npz"
    if not path.is_file():
        known = enumerated(sorted(each.stem for each in SHIPPED.glob("*.npz")))
        raise InputError(
            "coupling.predictor_file",
            f"be given for the scene {scene}",
            "nothing",
            f"write one with 'tissue train {scene} --out FILE'. Only the scenes {known} have a "
            "built-in predictor file",
        )
    return path


def is_trained(scene: str, file: str = "") -> bool:
    """Return True if trained predictors exist for a scene.

    The predictors are in `file`. If no file is given, they are in a file of the package.
    """
    return bool(file) or (SHIPPED / f"{scene}.npz").is_file()


@cache
def general_operator(*, without: str = "", step_m: float = inf) -> DelayOperator:
    """Return the operator fitted to the pooled training data of all built-in predictors.

    Every scene has the same weight. The data of the scene ``without`` are not used. ``step_m`` is
    the encoder step of the device. By default, the operator is for the encoder step of the devices
    used in training.
    """
    operators = [
        Trained.read(path).at_step(step_m).operator
        for path in sorted(SHIPPED.glob("*.npz"))
        if path.stem != without
    ]
    moments = Moments.pooled(each.moments for each in operators)
    return DelayOperator(moments, max(each.growth for each in operators))


def _checked(name: str, array: NDArray[Any]) -> Array:
    """Check the shape and the numbers of an array from a file, and return the array."""
    if array.dtype != np.float64 or not np.isfinite(array).all():
        raise DamagedFileError(f"{name} is not finite")
    if array.shape != SHAPES[name]:
        raise DamagedFileError(f"{name} has shape {array.shape}")
    return array
