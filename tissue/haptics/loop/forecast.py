"""Linear map of a predictor near a contact at rest, used in the stability analysis of the loop."""

import pickle
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.arrays import Array
from meshes.base.cache import Kept
from meshes.base.errors import InputError
from tissue.prediction.contact import Contact, SeesContact

if TYPE_CHECKING:
    from tissue.prediction.predictor import Predictor

__all__ = ["Forecast", "forecast_of"]

PROBES = (1e-5, 1e-3, 1e-3)
"""Changes used to probe a predictor: position [m], velocity [m/s], force [N]."""
LONGEST = 512
"""Largest number of ticks for which the response to a change is recorded."""
FADED = 1e-3
"""Share of the largest response below which a response has decayed."""
RIGID = 1e6
"""Stiffness of the tissue under the tool during a probe, relative to the coupling stiffness."""
SETTLING = 300
"""Ticks of a contact at rest before a predictor is probed."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Forecast:
    """Linear response of the predicted force: F(t) = sum over ages a of taps . (x, v, F)(t - a).

    Attributes
    ----------
    taps
        Responses, shape (phases, ages, 3), to position [N/m], velocity [N s/m] and force [N/N]. The
        phase is the tick of the observation, counted from the last model force. Only phase 0
        contains a force.
    gain
        Gain C of F + C (F_ahead - F): 0 plays the present force, 1 the predicted force.
    stiffness_N_m
        Coupling stiffness in the contact shown to the predictor. Its responses to position and
        velocity are proportional to this stiffness. None for a predictor without contact.
    """

    taps: Array
    gain: float = 1.0
    stiffness_N_m: float | None = None

    def __eq__(self, other: object) -> bool:
        """Compare by value, so that an equal predictor does not need another analysis."""
        return isinstance(other, Forecast) and self._value == other._value

    def __hash__(self) -> int:
        return hash(self._value)

    @cached_property
    def _value(self) -> tuple[bytes, tuple[int, ...], float, float | None]:
        return self.taps.tobytes(), self.taps.shape, self.gain, self.stiffness_N_m

    @property
    def memory(self) -> tuple[int, int]:
        """Number of previous positions and forces that the forecast uses."""
        ages = self.taps.shape[1]
        return ages if self.taps[:, :, :2].any() else 0, ages


_forecasts: Kept["Forecast"] = Kept(64)
"""Cache for the methods of a study in tens of trials."""


def forecast_of(
    predictor: "Predictor",
    *,
    lead_ticks: float,
    stiffness_N_m: float,
    model_ticks: int = 1,
    depth_m: float = 1e-3,
    axis: Array | None = None,
    gain: float = 1.0,
) -> Forecast:
    """Linearise a predictor about a contact at rest, by small changes of its inputs.

    Results are cached by the contents of the predictor, because a scene is judged several times:
    for its stiffness, its run and its reference.

    Parameters
    ----------
    predictor
        Predictor, which is copied and stays unchanged.
    lead_ticks
        Prediction horizon [ticks].
    stiffness_N_m, depth_m
        Stiffness and depth of the contact. The force is their product.
    model_ticks
        Ticks between two observed forces.
    axis
        Unit direction out of the tissue, shape (3,); default z.
    gain
        See `Forecast`.

    Raises
    ------
    InputError
        If the response to a change does not decay: the predictor is not a stable filter there.
    """
    out = np.array([0.0, 0.0, 1.0]) if axis is None else np.asarray(axis, dtype=np.float64)
    try:
        contents = pickle.dumps(predictor)
    except (
        TypeError,
        AttributeError,
        pickle.PicklingError,
    ):  # a user's predictor that cannot be compared with another one
        return _linearised(predictor, lead_ticks, stiffness_N_m, model_ticks, depth_m, out, gain)
    key = contents, lead_ticks, stiffness_N_m, model_ticks, depth_m, out.tobytes(), gain
    return _forecasts.of(
        key,
        lambda: _linearised(predictor, lead_ticks, stiffness_N_m, model_ticks, depth_m, out, gain),
    )


def _linearised(
    predictor: "Predictor",
    lead_ticks: float,
    stiffness_N_m: float,
    model_ticks: int,
    depth_m: float,
    out: Array,
    gain: float,
) -> Forecast:
    """Compute the forecast, without the cache."""
    still = -depth_m * out
    rest = np.zeros(3)
    force = stiffness_N_m * depth_m * out
    settled = deepcopy(predictor)
    contact = None
    if isinstance(settled, SeesContact):
        contact = Contact(
            stiffness_N_m, rest, force, RIGID * stiffness_N_m * np.outer(out, out), normal=out
        )
    ticks = -(-SETTLING // model_ticks) * model_ticks
    for tick in range(ticks):
        if contact is not None:
            settled.meet(contact)  # type: ignore[attr-defined]
        settled.observe(still, rest, force if tick % model_ticks == 0 else None)
        settled.predict(lead_ticks)
    taps = np.zeros((model_ticks, LONGEST + 1, 3))
    seen = still, rest, force
    quiet = _answers(deepcopy(settled), contact, seen, rest, None, 0, lead_ticks, model_ticks, out)
    for phase in range(model_ticks):
        for channel in range(3 if phase == 0 else 2):
            change = PROBES[channel] * out
            changed = _answers(
                deepcopy(settled),
                contact,
                seen,
                change,
                channel,
                phase,
                lead_ticks,
                model_ticks,
                out,
            )
            taps[phase, :, channel] = (changed - quiet)[phase : phase + LONGEST + 1] / PROBES[
                channel
            ]
    return Forecast(
        taps=_faded(taps), gain=gain, stiffness_N_m=None if contact is None else stiffness_N_m
    )


def _answers(
    predictor: "Predictor",
    contact: Contact | None,
    seen: tuple[Array, Array, Array],
    change: Array,
    channel: int | None,
    at: int,
    lead_ticks: float,
    model_ticks: int,
    out: Array,
) -> Array:
    """Return the predicted forces along the axis after a change of one input in one tick [N]."""
    forces = np.zeros(LONGEST + 1 + model_ticks)
    for tick in range(len(forces)):
        shown = [
            array + change if tick == at and index == channel else array
            for index, array in enumerate(seen)
        ]
        if contact is not None:
            predictor.meet(contact)  # type: ignore[attr-defined]
        predictor.observe(shown[0], shown[1], shown[2] if tick % model_ticks == 0 else None)
        forces[tick] = float(predictor.predict(lead_ticks) @ out)
    return forces


def _faded(taps: Array) -> Array:
    """Return the responses up to the age at which they have decayed."""
    sizes = np.abs(taps) / np.maximum(np.abs(taps).max(axis=(0, 1)), 1e-300)
    ages = sizes.max(axis=(0, 2))
    if not np.isfinite(ages).all() or ages[-1] > FADED:
        raise InputError(
            "predictor",
            f"forget a change within {LONGEST} ticks to be judged",
            "one that does not",
            "train it with capped eigenvalues, or use another",
        )
    return taps[:, : int(np.flatnonzero(ages > 0.1 * FADED)[-1]) + 1]
