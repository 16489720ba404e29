"""A predictor by its name."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

from meshes.base.errors import InputError
from tissue.prediction.baselines import Kalman, Linear, LinearControl
from tissue.prediction.guard import Guarded, Judged
from tissue.prediction.koopman import Koopman
from tissue.prediction.look_ahead import LookAhead
from tissue.prediction.paths import FilteredPath, OperatorPath
from tissue.prediction.predictor import Hold, Predictor
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
"""Predictors without a lifted operator, of which training chooses what a lifted one hands over
to.
"""


def maker_of(
    kind: str, *, scene_name: str, file: str, force_limit_N: float
) -> Callable[[], Predictor]:
    """Return what makes new predictors for a scene's device; a trained one is read once, by the
    first.

    Parameters
    ----------
    kind
        One of `PREDICTORS`.
    scene_name
        Name of the scene, which the file must be of.
    file
        What `tissue train` has written; empty for the scene's own.
    force_limit_N
        Largest force of the device: no predictor goes further than this from the present force.

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
    """A predictor by its name in `PREDICTORS`, guarded, with what was trained for it.

    Raises
    ------
    InputError
        If there is none of that kind, or nothing was trained for one that needs it.
    """
    entry = PREDICTORS[kind]
    if entry.trained and trained is None:
        raise InputError("trained", f"be given for {kind}", "nothing", "pass Trained.read(FILE)")
    make: Callable[[Trained | None, float], Predictor] = (
        entry.make or globals()[kind.replace("-", "_")]
    )
    return make(trained, force_limit_N)


def hold(trained: Trained | None, force_limit_N: float) -> Predictor:
    """The last force stays."""
    return Hold()


def linear(trained: Trained | None, force_limit_N: float) -> Predictor:
    """The force goes on along its line."""
    return Guarded(Linear(), Hold(), reach_N=force_limit_N)


def kalman(trained: Trained | None, force_limit_N: float) -> Predictor:
    """The force goes on as a Kalman filter estimates it."""
    return Guarded(Kalman(), Hold(), reach_N=force_limit_N)


def dmdc(trained: Trained | None, force_limit_N: float) -> Predictor:
    """Linear dynamic mode decomposition with control."""
    assert trained is not None
    return Guarded(LinearControl(trained.control), Hold(), reach_N=force_limit_N)


def look_ahead(trained: Trained | None, force_limit_N: float) -> Predictor:
    """The tissue's own law at the end of a filtered path."""
    return Guarded(LookAhead(FilteredPath()), Hold(), reach_N=force_limit_N)


def koopman(trained: Trained | None, force_limit_N: float) -> Predictor:
    """The lifted predictor, which hands over to the best one without an operator."""
    assert trained is not None
    return _with_fallback("koopman", Koopman(_path(trained)), trained, force_limit_N)


def koopman_look_ahead(trained: Trained | None, force_limit_N: float) -> Predictor:
    """The tissue's own law at the end of the path that the lifted operator foresees."""
    assert trained is not None
    return _with_fallback("koopman-look-ahead", LookAhead(_path(trained)), trained, force_limit_N)


def _path(trained: Trained) -> OperatorPath:
    """The operator's path, with the range of its training."""
    return OperatorPath(trained.operator, growth=trained.growth)


def _with_fallback(kind: str, lifted: Judged, trained: Trained, force_limit_N: float) -> Predictor:
    """A lifted predictor, and what is asked where it is not trusted; throughout, if validation
    found it no gain.
    """
    fallback = trained_predictor(trained.fallback, trained, force_limit_N=force_limit_N)
    return fallback if trained.loses(kind) else Guarded(lifted, fallback, reach_N=force_limit_N)
