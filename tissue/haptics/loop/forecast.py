"""Linear model of a force predictor near a contact at rest, for the stability analysis."""

import pickle
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from math import isnan
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.arrays import Array
from meshes.base.cache import RecentResults
from meshes.base.errors import InputError
from tissue.prediction.predictor import Contact, SeesContact

if TYPE_CHECKING:
    from tissue.prediction.predictor import Predictor

PROBES = (1e-5, 1e-3, 1e-3)
"""Changes of position [m], velocity [m/s] and force [N] used to probe a predictor.

The change of position is 1 % of the depth of the contact, so that the response is linear.
"""
LONGEST = 512
"""Largest number of ticks for which a predictor's response to a change is recorded.

The value is five times the longest memory of the built-in predictors, which is 102 ticks.
"""
FADED = 1e-3
"""Share of the largest response below which a response is treated as decayed.

Short responses make the analysis faster, because `loop_matrix` has one state per tick of memory.
"""
RIGID = 1e6
"""Stiffness of the tissue during a probe, divided by the coupling stiffness.

In the stability analysis, the coupling is the virtual wall. The tissue behind the coupling must
therefore be nearly rigid.
"""
SETTLING = 300
"""Number of ticks for which a predictor sees a contact at rest before it is probed.

The value is three times the longest memory of the built-in predictors.
"""


@dataclass(frozen=True, eq=False, kw_only=True)
class Forecast:
    """Linear model of a predicted force: taps(a) . (x, v, F)(t - a), summed over all ages a.

    Two forecasts are equal only if they are the same object. For equal predictors, `forecast_of`
    returns the same object, so that cached results of the stability analysis can be reused.

    Attributes
    ----------
    taps
        Responses, shape (phases, ages, 3), to position x [N/m], velocity v [N s/m] and force F
        [N/N]. The phase is the number of ticks from the last response of the tissue model to the
        observation. A force is observed only in phase 0.
    gain
        Gain C. The force at the device is F + C (F_ahead - F), with the present force F and the
        predicted force F_ahead. A gain of 0 gives the present force, and a gain of 1 the predicted
        force.
    stiffness_N_m
        Stiffness of the contact for which the responses were computed [N/m]. The responses to
        position and velocity are proportional to this stiffness. None for a predictor without
        contact.
    """

    taps: Array
    gain: float = 1.0
    stiffness_N_m: float | None = None

    @property
    def memory(self) -> tuple[int, int]:
        """Numbers of previous positions and previous forces that the forecast uses."""
        ages = self.taps.shape[1]
        return ages if self.taps[:, :, :2].any() else 0, ages


_forecasts: RecentResults["Forecast"] = RecentResults(256)
"""Cache of forecasts; a study needs about ten for each combination of task, latency and device."""
OUT = np.array([0.0, 0.0, 1.0])
"""Direction out of the tissue during a probe."""


def forecast_of(
    predictor: "Predictor",
    *,
    lead_ticks: float,
    stiffness_N_m: float,
    model_ticks: int = 1,
    depth_m: float = 1e-3,
    gain: float = 1.0,
) -> Forecast:
    """Return the linear model of a predictor, from its response to small changes of its inputs.

    The inputs are changed during a contact at rest. Results are cached, because the stability of a
    scene is checked several times. The key of the cache contains the data of the predictor.

    Parameters
    ----------
    predictor
        Predictor. It is copied and not changed.
    lead_ticks
        Prediction horizon [ticks].
    stiffness_N_m, depth_m
        Stiffness [N/m] and depth [m] of the contact. The contact force is the product of both.
    model_ticks
        Ticks between two observed forces.
    gain
        See `Forecast`.

    Raises
    ------
    InputError
        If the response to a change is not finite or does not decay, or if `predict` changes the
        predictor.
    """
    probe = _Probe(lead_ticks, stiffness_N_m, model_ticks, depth_m)
    try:
        contents = pickle.dumps(predictor)
    except (TypeError, AttributeError, pickle.PicklingError):
        # a user's predictor that cannot be compared with another one
        return probe.forecast(predictor, gain)
    return _forecasts.of((contents, probe, gain), lambda: probe.forecast(predictor, gain))


@dataclass(frozen=True)
class _Probe:
    """Contact at rest with which a predictor is probed; see `forecast_of`."""

    lead_ticks: float
    stiffness_N_m: float
    model_ticks: int
    depth_m: float

    def forecast(self, predictor: "Predictor", gain: float) -> Forecast:
        """Compute the forecast without using the cache."""
        settled = deepcopy(predictor)
        count = self.model_ticks
        seen = (-self.depth_m * OUT, np.zeros(3), self.stiffness_N_m * self.depth_m * OUT)
        for tick in range(-(-SETTLING // count) * count):
            force = self._show(settled, seen, tick)
        again = settled.predict(self.lead_ticks) @ OUT
        if again != force and not (isnan(again) and isnan(force)):
            raise InputError(
                "predictor",
                "return the same force in two calls of predict",
                f"{force:.4g} N and {again:.4g} N",
                "change the state of the predictor in observe only",
            )
        taps = np.zeros((count, LONGEST + 1, 3))
        quiet = self._answers(deepcopy(settled), seen, seen, 0)
        for phase in range(count):
            # A force is observed only in phase 0.
            for channel in range(3 if phase == 0 else 2):
                changed = [each.copy() for each in seen]
                changed[channel] += PROBES[channel] * OUT
                answers = self._answers(deepcopy(settled), seen, changed, phase)
                moved = (answers - quiet)[phase : phase + LONGEST + 1]
                taps[phase, :, channel] = moved / PROBES[channel]
        sees = isinstance(settled, SeesContact)
        return Forecast(
            taps=_faded(taps), gain=gain, stiffness_N_m=self.stiffness_N_m if sees else None
        )

    def _show(self, predictor: "Predictor", seen: Sequence[Array], tick: int) -> Array:
        """Pass the observations of a tick to a predictor, and return its normal force."""
        if isinstance(predictor, SeesContact):
            force = self.stiffness_N_m * self.depth_m * OUT
            rigid = RIGID * self.stiffness_N_m * np.outer(OUT, OUT)
            predictor.meet(Contact(self.stiffness_N_m, np.zeros(3), force, rigid, normal=OUT))
        predictor.observe(seen[0], seen[1], seen[2] if tick % self.model_ticks == 0 else None)
        return predictor.predict(self.lead_ticks) @ OUT

    def _answers(
        self, predictor: "Predictor", seen: Sequence[Array], changed: Sequence[Array], at: int
    ) -> Array:
        """Return the predicted normal forces [N] if the inputs are changed in one tick."""
        ticks = range(LONGEST + 1 + self.model_ticks)
        return np.array([self._show(predictor, changed if n == at else seen, n) for n in ticks])


def _faded(taps: Array) -> Array:
    """Return the responses without the ages at which the responses have decayed."""
    # 1e-300 avoids a division by zero in a channel without any response.
    sizes = np.abs(taps) / np.maximum(np.abs(taps).max(axis=(0, 1)), 1e-300)
    ages = sizes.max(axis=(0, 2))
    if not np.isfinite(ages).all():
        raise InputError(
            "predictor",
            "return finite forces at a contact at rest",
            "NaN or infinity",
            "fix predict",
        )
    if ages[-1] > FADED:
        raise InputError(
            "predictor",
            f"have a response that decays within {LONGEST} ticks",
            "a response that does not decay",
            "train the predictor with capped eigenvalues, or use another predictor",
        )
    # Responses down to a tenth of the bound are kept, so the truncation has no effect on the
    # analysis. A constant force has no response: one age of zeros is kept.
    return taps[:, : int(np.flatnonzero(ages > 0.1 * FADED).max(initial=0)) + 1]
