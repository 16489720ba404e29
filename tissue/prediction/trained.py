"""What training leaves behind for a scene: operators and the terms of the loop, in a file."""

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.errors import InputError
from tissue.prediction.edmd.lifted import Operator
from tissue.prediction.edmd.predictor_file import read_predictor, write_predictor
from tissue.prediction.koopman import LoopTerms

__all__ = ["Trained", "shipped_file"]


@dataclass(frozen=True)
class Trained:
    """Predictors trained on a scene.

    Attributes
    ----------
    scene
        Name of the scene.
    operator
        Of the lifted predictor; states are the device's position [m] and the force on it [N].
    control
        Of linear dynamic mode decomposition; states are the force, inputs position and velocity of the device.
    terms
        What else the lifted predictor needs in a loop.
    facts
        How it was trained and validated: numbers and names.
    """

    scene: str
    operator: Operator
    control: Operator
    terms: LoopTerms
    facts: dict[str, Any] = field(default_factory=dict)

    def write(self, path: Path, *, overwrite: bool = False) -> Path:
        """Write it; operators in single precision and without moments, which keeps the file small.

        Raises
        ------
        InputError
            If the file exists and may not be written over, or its folder is missing.
        """
        terms = asdict(self.terms)
        following = terms.pop("following")
        operators = {"lifted": _rounded(self.operator), "control": _rounded(self.control)}
        header = {"terms": terms, "told": self.facts}
        arrays = {"following": following}
        return write_predictor(path, operators, scene=self.scene, header=header, arrays=arrays, overwrite=overwrite)

    @classmethod
    def read(cls, path: Path, *, scene: str | None = None) -> "Trained":
        """Read one, of the given scene.

        Raises
        ------
        InputError
            If the file is missing, damaged, or of another version or scene.
        """
        stored = read_predictor(path, scene=scene)
        try:
            given = stored.header["terms"]
            terms = LoopTerms(**{**given, "gains": tuple(given["gains"])}, following=stored.arrays["following"])
            lifted, control = stored.operators["lifted"], stored.operators["control"]
            return cls(stored.scene, lifted, control, terms, stored.header["told"])
        except (KeyError, TypeError) as problem:
            raise InputError(
                f"predictor file must hold what a loop needs, got {path} without {problem}: train it again with "
                f"'tissue train {stored.scene}'"
            ) from None


def shipped_file(scene: str) -> Path:
    """Where the predictor of a built-in scene lies.

    Raises
    ------
    InputError
        If there is none.
    """
    folder = Path(__file__).parent / "trained"
    path = folder / f"{scene}.npz"
    if not path.is_file():
        known = ", ".join(sorted(each.stem for each in folder.glob("*.npz")))
        raise InputError(
            f"coupling.predictor_file must be given for a scene other than {known}, got nothing for {scene}: write one "
            f"with 'tissue train {scene} --out FILE'"
        )
    return path


def _rounded(operator: Operator) -> Operator:
    """The operator with its matrices in single precision, and without the moments that only `Online` needs."""
    short = {name: getattr(operator, name).astype(np.float32).astype(np.float64) for name in ("A", "B")}
    return replace(operator, **short, moments=np.zeros((0, 0)))
