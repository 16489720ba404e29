"""A predictor by its name."""

from pathlib import Path

from meshes.base.errors import InputError
from tissue.models.tissue_model import TICK_S
from tissue.prediction.baselines import Kalman, Linear, LinearControl
from tissue.prediction.guard import Guarded
from tissue.prediction.koopman import Koopman
from tissue.prediction.predictor import Hold, Predictor
from tissue.prediction.trained import Trained, shipped_file

__all__ = ["PREDICTORS", "predictor", "trained_predictor"]

PREDICTORS = ("hold", "linear", "kalman", "dmdc", "koopman")


def predictor(kind: str, *, scene_name: str, file: str, force_limit_N: float, tick_s: float) -> Predictor:
    """A predictor for a scene's device.

    Parameters
    ----------
    kind
        One of `PREDICTORS`; dmdc and koopman are trained.
    scene_name
        Name of the scene, which the file must be of.
    file
        What `tissue train` has written; empty for the scene's own.
    force_limit_N
        Greatest force of the device: no predictor goes further than this from the present force.
    tick_s
        Length of a tick [s].

    Raises
    ------
    InputError
        If there is none of that kind, or its file is missing, damaged, or of another version, scene or tick.
    """
    if kind not in PREDICTORS:
        raise InputError(f"prediction must be one of {', '.join(PREDICTORS)}, got {kind}: choose one of these")
    trained = None
    if kind in ("dmdc", "koopman"):
        if abs(tick_s - TICK_S) > 1e-9:
            raise InputError(
                f"device must have a tick of {1e3 * TICK_S:g} ms for a trained predictor, got {1e3 * tick_s:g}: use "
                "prediction = kalman"
            )
        path = Path(file) if file else shipped_file(scene_name)
        trained = Trained.read(path, scene=scene_name)
    return trained_predictor(kind, trained, force_limit_N=force_limit_N)


def trained_predictor(kind: str, trained: Trained | None, *, force_limit_N: float) -> Predictor:
    """A predictor by its name, guarded, with what was trained for it."""
    match kind:
        case "linear":
            return Guarded(Linear(), Hold(), reach_N=force_limit_N)
        case "kalman":
            return Guarded(Kalman(), Hold(), reach_N=force_limit_N)
        case "dmdc" if trained is not None:
            return Guarded(LinearControl(trained.control), Hold(), reach_N=force_limit_N)
        case "koopman" if trained is not None:
            return Guarded(Koopman(trained.operator, trained.terms), Linear(), reach_N=trained.terms.reach_N)
    return Hold()
