"""Predictors by name."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

from meshes.base.errors import InputError
from tissue.prediction.guard import Guarded, Judged
from tissue.prediction.koopman import Koopman, OperatorPath
from tissue.prediction.look_ahead import FilteredPath, LookAhead
from tissue.prediction.predictor import Hold, Kalman, Linear, LinearControl, Predictor
from tissue.prediction.trained import Trained, shipped_file
from tissue.scene.registry import PREDICTORS

__all__ = [
    "FALLBACKS",
    "dmdc",
    "hold",
    "kalman",
    "koopman",
    "koopman_look_ahead",
    "linear",
    "look_ahead",
    "maker_of",
    "trained_predictor",
]

FALLBACKS = ("hold", "linear", "kalman", "dmdc", "look-ahead")
"""Predictors without a lifted operator.

Training chooses the fallback of a lifted predictor among them.
"""


def maker_of(
    kind: str, *, scene_name: str, file: str, force_limit_N: float
) -> Callable[[], Predictor]:
    """Return a function that makes new predictors for a scene's device.

    A trained predictor is read from its file once, by the first call.

    Parameters
    ----------
    kind
        One of `PREDICTORS`.
    scene_name
        Name of the scene, for which the file must be trained.
    file
        File written by `tissue train`; empty for the file shipped for the scene.
    force_limit_N
        Largest force of the device. No prediction differs from the present force by more than this.

    Raises
    ------
    InputError
        By the first call, if the file is missing, damaged, or of another version or scene.
    """

    @cache
    def trained() -> Trained | None:
        if not PREDICTORS[kind].trained:
            return None
        return Trained.read(Path(file) if file else shipped_file(scene_name), scene=scene_name)

    return lambda: trained_predictor(kind, trained(), force_limit_N=force_limit_N)


def trained_predictor(kind: str, trained: Trained | None, *, force_limit_N: float) -> Predictor:
    """Return a guarded predictor by its name in `PREDICTORS`, with its trained parameters.

    Raises
    ------
    InputError
        If there is no predictor of that kind, or it needs training and `trained` is None.
    """
    entry = PREDICTORS[kind]
    if entry.trained and trained is None:
        raise InputError("trained", f"be given for {kind}", "nothing", "pass Trained.read(FILE)")
    make: Callable[[Trained | None, float], Predictor] = (
        entry.make or globals()[kind.replace("-", "_")]
    )
    return make(trained, force_limit_N)


def hold(trained: Trained | None, force_limit_N: float) -> Predictor:
    """Return a predictor that holds the last force."""
    return Hold()


def linear(trained: Trained | None, force_limit_N: float) -> Predictor:
    """Return a predictor that extrapolates the force linearly."""
    return Guarded(Linear(), Hold(), reach_N=force_limit_N)


def kalman(trained: Trained | None, force_limit_N: float) -> Predictor:
    """Return a predictor that extrapolates the force with a Kalman filter."""
    return Guarded(Kalman(), Hold(), reach_N=force_limit_N)


def dmdc(trained: Trained | None, force_limit_N: float) -> Predictor:
    """Return a predictor by linear dynamic mode decomposition with control."""
    assert trained is not None
    return Guarded(LinearControl(trained.control), Hold(), reach_N=force_limit_N)


def look_ahead(trained: Trained | None, force_limit_N: float) -> Predictor:
    """Return a predictor that evaluates the tissue's own law at the end of a filtered path."""
    return Guarded(LookAhead(FilteredPath()), Hold(), reach_N=force_limit_N)


def koopman(trained: Trained | None, force_limit_N: float) -> Predictor:
    """Return the lifted predictor; its fallback is the best predictor without an operator."""
    assert trained is not None
    return _with_fallback("koopman", Koopman(_path(trained)), trained, force_limit_N)


def koopman_look_ahead(trained: Trained | None, force_limit_N: float) -> Predictor:
    """Return a predictor by the tissue's own law at the end of the lifted operator's path."""
    assert trained is not None
    return _with_fallback("koopman-look-ahead", LookAhead(_path(trained)), trained, force_limit_N)


def _path(trained: Trained) -> OperatorPath:
    """Return the operator's path, with the range of its training."""
    return OperatorPath(trained.operator, growth=trained.growth)


def _with_fallback(kind: str, lifted: Judged, trained: Trained, force_limit_N: float) -> Predictor:
    """Return a lifted predictor guarded by its fallback.

    The fallback is used throughout if validation found no gain by the lifted predictor.
    """
    fallback = trained_predictor(trained.fallback, trained, force_limit_N=force_limit_N)
    return fallback if trained.loses(kind) else Guarded(lifted, fallback, reach_N=force_limit_N)
