"""Predictors by name."""

from collections.abc import Callable
from functools import cache
from math import inf
from pathlib import Path

import numpy as np

from meshes.base.errors import InputError
from tissue.haptics.loop.filters import ForceRange
from tissue.materials.constants import constants
from tissue.perception.laws import intensity_of, weber_of
from tissue.perception.mapping import ForceMap
from tissue.perception.observer import (
    Observer,
    population_observer,
    read_observer,
    reference_observer,
)
from tissue.perception.perceived import Deadband, PerceivedForce, Sense
from tissue.perception.perception import Perception
from tissue.prediction.baselines import Kalman, Linear, LinearControl
from tissue.prediction.guard import Guarded, Judged
from tissue.prediction.koopman import Koopman
from tissue.prediction.look_ahead import LookAhead
from tissue.prediction.paths import FilteredPath, OperatorPath
from tissue.prediction.predictor import Hold, Predictor
from tissue.prediction.trained import Trained, shipped_file
from tissue.scene.registry import PERCEPTIONS, PREDICTORS

__all__ = [
    "CAUTION",
    "FALLBACKS",
    "dmdc",
    "hold",
    "kalman",
    "koopman",
    "koopman_look_ahead",
    "linear",
    "look_ahead",
    "maker_of",
    "of_observer",
    "of_population",
    "perception",
    "perception_for",
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


CAUTION = 0.1
"""Quantile of the threshold's distribution that bounds the deadband.

Nine in ten observers have a larger threshold.
"""


def perception(
    choice: str,
    *,
    rng: np.random.Generator,
    force_limit_N: float,
    tick_s: float,
    friction_N: float = inf,
) -> Perception | None:
    """Return a perception by its name in `PERCEPTIONS`; None for ``none``.

    Parameters
    ----------
    choice
        The name.
    rng
        Random generator of the observer's sensory noise.
    force_limit_N
        Largest force of the device [N].
    tick_s
        Time between two steps [s].
    friction_N
        Coulomb friction of the device [N]. The deadband is no wider than this, so at every instant
        friction dissipates the energy that the held force supplies. Use infinity to bound the
        deadband by the threshold alone.

    Raises
    ------
    InputError
        If the name is unknown or the file cannot be used.
    """
    if choice == "none":
        return None
    name, argument = PERCEPTIONS.split(choice, "none")
    make = PERCEPTIONS[name] or {"population": of_population, "observer:FILE": of_observer}[name]
    return make(
        argument, rng=rng, force_limit_N=force_limit_N, tick_s=tick_s, friction_N=friction_N
    )


def of_population(
    argument: str,
    *,
    rng: np.random.Generator,
    force_limit_N: float,
    tick_s: float,
    friction_N: float,
) -> PerceivedForce:
    """Return the perception of an unknown observer from the population."""
    return perception_for(
        population_observer(),
        rng=rng,
        force_limit_N=force_limit_N,
        tick_s=tick_s,
        friction_N=friction_N,
    )


def of_observer(
    argument: str,
    *,
    rng: np.random.Generator,
    force_limit_N: float,
    tick_s: float,
    friction_N: float,
) -> PerceivedForce:
    """Return the perception of the observer in a file written by `tissue calibrate`."""
    return perception_for(
        read_observer(Path(argument)),
        rng=rng,
        force_limit_N=force_limit_N,
        tick_s=tick_s,
        friction_N=friction_N,
    )


def perception_for(
    observer: Observer,
    *,
    rng: np.random.Generator,
    force_limit_N: float,
    tick_s: float,
    friction_N: float = inf,
) -> PerceivedForce:
    """Return the perception of an observer on a device; see `perception`."""
    device = ForceRange(limit_N=force_limit_N)
    knee_N = device.knee_share * device.limit_N
    reference = reference_observer()
    lowest_N = min(observer.offset_N, 0.5 * knee_N)
    law = ForceMap(
        intensity_of(reference), intensity_of(observer), lowest_N=lowest_N, knee_N=knee_N
    )
    held = weber_of(observer, quantile=CAUTION)
    sentence = (
        f"felt by {observer.name}: changes below {held.kappa:.3g} of (F + {held.offset:.3g} N) "
        "are held back"
    )
    if law.gain < 1.0:
        sentence += (
            f", and all intensities are {law.gain**reference.beta:.3g} of the reference "
            "observer's, so that the "
            "device can play them in their ratios"
        )
    return PerceivedForce(
        law,
        Deadband(held, widest=friction_N),
        Sense(
            weber_of(observer),
            integration_s=constants("perception", "force")["integration_s"].value,
            tick_s=tick_s,
            rng=rng,
        ),
        sentence=sentence,
    )
