"""A predictor by its name."""

from meshes.errors import InputError
from tissue.prediction.predictor import Hold, Predictor

__all__ = ["predictor"]


def predictor(kind: str, *, scene_name: str, file: str, force_limit_N: float, tick_s: float) -> Predictor:
    """A predictor for a scene's device.

    Raises
    ------
    InputError
        If there is none of that kind.
    """
    if kind == "hold":
        return Hold()
    raise InputError(f"prediction must be one of hold, got {kind}: choose one of these")
