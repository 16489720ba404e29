"""Construction of force predictors and perceptual maps from their names in a scene."""

from collections.abc import Callable
from functools import cache
from math import inf
from pathlib import Path

import numpy as np

from meshes.base.errors import InputError
from tissue.haptics.loop.filters import ForceRange
from tissue.materials.constants import constants
from tissue.perception.laws import ForceMap, intensity_of, weber_of
from tissue.perception.observer import (
    Observer,
    population_observer,
    read_observer,
    reference_observer,
)
from tissue.perception.perceived import Deadband, PerceivedForce, Perception, Sense
from tissue.prediction.delays import DelayPath
from tissue.prediction.guard import Guarded, Judged
from tissue.prediction.koopman import Koopman
from tissue.prediction.look_ahead import LookAhead
from tissue.prediction.online import AdaptivePath
from tissue.prediction.predictor import Hold, Kalman, Linear, Predictor
from tissue.prediction.trained import Trained, general_operator, is_trained, shipped_file
from tissue.scene.registry import PERCEPTIONS, PREDICTORS

FALLBACKS = ("hold", "linear", "kalman")
"""Names of predictors without a Koopman operator.

For a predictor with a Koopman operator, training chooses one of these predictors as fallback.
"""
ADAPTIVE = "koopman-online"
"""Name of the predictor that adapts its Koopman operator during the run.

If the scene has no trained operator, the predictor starts from a general operator.
"""
CAUTION = 0.1
"""Quantile of a population's thresholds for force changes that is used for the deadband.

Nine in ten people have a larger threshold.
"""


def maker_of(
    kind: str, *, scene_name: str, file: str, force_limit_N: float, encoder_step_m: float
) -> Callable[[], Predictor]:
    """Return a function that makes new predictors for a scene's device.

    The first call of the returned function reads the file of a trained predictor. Later calls use
    the data that the first call has read.

    Parameters
    ----------
    kind
        Name of a predictor in `PREDICTORS`.
    scene_name
        Name of the scene for which the predictor in the file must have been trained.
    file
        File that `tissue train` wrote. If empty, the file that is shipped for the scene is used.
    force_limit_N
        Largest force of the device. The difference between a prediction and the current force is
        limited to this value.
    encoder_step_m
        Encoder step of the device [m].

    Raises
    ------
    InputError
        In the first call of the returned function, if the file is missing or damaged, or belongs to
        another version or scene.
    """

    @cache
    def trained() -> Trained | None:
        known = is_trained(scene_name, file)
        if not (PREDICTORS[kind].trained or (kind == ADAPTIVE and known)):
            return None
        found = Trained.read(Path(file) if file else shipped_file(scene_name), scene=scene_name)
        return found.at_step(encoder_step_m)

    return lambda: trained_predictor(
        kind, trained(), force_limit_N=force_limit_N, encoder_step_m=encoder_step_m
    )


def trained_predictor(
    kind: str, trained: Trained | None, *, force_limit_N: float, encoder_step_m: float = inf
) -> Predictor:
    """Return the predictor that a name in `PREDICTORS` selects, with its trained parameters.

    If `koopman-online` has no trained parameters, it uses an operator for the encoder step of the
    device, `encoder_step_m` [m]. By default, the encoder step of the devices that were used for
    training is assumed.

    Raises
    ------
    InputError
        If the predictor is unknown, or needs training and `trained` is None.
    """
    entry = PREDICTORS[kind]
    if entry.trained and trained is None:
        raise InputError("trained", f"be given for {kind}", "nothing", "pass Trained.read(FILE)")
    if entry.make is not None:
        made: Predictor = entry.make(trained, force_limit_N)
        return made
    if kind == "hold":
        return Hold()
    if kind in FALLBACKS:
        simple: Judged = Linear() if kind == "linear" else Kalman()
        return Guarded(simple, Hold(), reach_N=force_limit_N)
    fallback: Predictor = Hold()
    slopes = "given"
    if trained is not None:
        fallback = trained_predictor(trained.fallback, trained, force_limit_N=force_limit_N)
        slopes = "none" if trained.loses("koopman-look-ahead", "koopman") else "learnt"
        best = "koopman" if kind == "koopman" or slopes == "none" else "koopman-look-ahead"
        if trained.loses(best, "hold"):
            # The operator brought no improvement on the validation data.
            return fallback
    if kind == ADAPTIVE:
        path: DelayPath = AdaptivePath(
            general_operator(step_m=encoder_step_m) if trained is None else trained.operator
        )
    else:
        assert trained is not None
        path = DelayPath(trained.operator)
    made_of = Koopman(path) if kind == "koopman" else LookAhead(path, slopes=slopes)
    return Guarded(made_of, fallback, reach_N=force_limit_N)


def perception(
    choice: str | Observer,
    *,
    rng: np.random.Generator,
    force_limit_N: float,
    tick_s: float,
    friction_N: float = inf,
) -> Perception:
    """Return the perceptual map of forces, given by a name in `PERCEPTIONS` or by an observer.

    Parameters
    ----------
    choice
        Observer, or the name of a perceptual map. For some maps, the name is followed by an
        argument, such as a file.
    rng
        Random generator of the sensory noise of the person.
    force_limit_N
        Largest force of the device [N].
    tick_s
        Time between two steps [s].
    friction_N
        Coulomb friction of the device [N]. The deadband is limited to this value, so that friction
        always dissipates the energy that a held (not updated) force supplies. With infinity, only
        the threshold limits the deadband.

    Raises
    ------
    InputError
        If the name is unknown or the file cannot be used.
    """
    observer = choice
    if isinstance(observer, str):
        name, argument = PERCEPTIONS.split(observer, "none")
        make = PERCEPTIONS[name]
        if make is not None:
            limits = {"force_limit_N": force_limit_N, "tick_s": tick_s, "friction_N": friction_N}
            made: Perception = make(argument, rng=rng, **limits)
            return made
        observer = population_observer() if name == "population" else read_observer(Path(argument))
    device = ForceRange(limit_N=force_limit_N)
    knee_N = device.knee_N
    reference = reference_observer()
    lowest_N = min(observer.offset_N, 0.5 * knee_N)
    law = ForceMap(
        intensity_of(reference), intensity_of(observer), lowest_N=lowest_N, knee_N=knee_N
    )
    held = weber_of(observer, quantile=CAUTION)
    sentence = (
        f"as perceived by {observer.name}: changes below {held.kappa:.3g} of (F + "
        f"{held.offset:.3g} N) are not played"
    )
    if law.gain < 1.0:
        sentence += (
            f", and all intensities are {law.gain**reference.beta:.3g} times the intensities of "
            "the reference observer, so that the device can play their ratios"
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
