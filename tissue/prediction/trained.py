"""Trained predictors of a scene in a file: operators, their range and the fallback outside it."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.errors import InputError
from tissue.prediction.edmd.lifted import Operator
from tissue.prediction.edmd.predictor_file import read_predictor, write_predictor

__all__ = ["VALIDATED_AT", "Trained", "is_trained", "shipped_file"]

SHIPPED = Path(__file__).parent / "trained"
"""Folder of the predictors that ship with the engine, one file a scene."""
VALIDATED_AT = 6
"""Lead in whole ticks at which predictors are compared in training.

It is the lead for 4 ms of latency, which is 6.11 ticks on a touch with its path to the motor, see
`tissue.simulation.builders.loop.lead_ticks`.
"""


@dataclass(frozen=True)
class Trained:
    """Predictors trained on a scene.

    Attributes
    ----------
    scene
        Name of the scene.
    operator
        Operator of the lifted predictors, on displacement and stretch of an axis [m], see
        `tissue.prediction.paths`.
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

        The errors are compared at a loop's usual lead.
        """
        if "validation" not in self.facts:
            return False
        errors = self.facts["validation"]["errors"]
        horizons = self.facts["validation"]["horizons_ms"]
        at = horizons.index(VALIDATED_AT)
        return bool(errors[kind][at] > errors["hold"][at])

    def write(self, path: Path, *, overwrite: bool = False) -> Path:
        """Write the predictors to a file.

        Operators are written in single precision and without moments, which keeps the file small.

        Raises
        ------
        InputError
            If the file exists and may not be written over, or its folder is missing.
        """
        operators = {"lifted": _rounded(self.operator), "control": _rounded(self.control)}
        header = {"growth": self.growth, "fallback": self.fallback, "facts": self.facts}
        return write_predictor(
            path, operators, scene=self.scene, header=header, overwrite=overwrite
        )

    @classmethod
    def read(cls, path: Path, *, scene: str | None = None) -> "Trained":
        """Read the trained predictors of a scene.

        Raises
        ------
        InputError
            If the file is missing, damaged, or of another version or scene.
        """
        stored = read_predictor(path, scene=scene)
        try:
            lifted = stored.operators["lifted"]
            control = stored.operators["control"]
            header = stored.header
            return cls(
                stored.scene,
                lifted,
                control,
                float(header["growth"]),
                header["fallback"],
                header["facts"],
            )
        except (KeyError, TypeError) as problem:
            raise InputError(
                "predictor file",
                "hold what a loop needs",
                f"{path} without {problem}",
                f"train it again with 'tissue train {stored.scene}'",
            ) from None


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


def _rounded(operator: Operator) -> Operator:
    """Return the operator in single precision, without the moments that only `Online` needs."""
    short = {
        name: getattr(operator, name).astype(np.float32).astype(np.float64) for name in ("A", "B")
    }
    return replace(operator, **short, moments=np.zeros((0, 0)))
