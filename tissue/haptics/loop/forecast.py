"""A predictor near a contact at rest, as the linear map that the judge of stability puts into
its loop.
"""

import pickle
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.kept import Kept
from tissue.prediction.contact import Contact, SeesContact

if TYPE_CHECKING:
    from tissue.prediction.predictor import Predictor

__all__ = ["Forecast", "forecast_of"]

PROBES = (1e-5, 1e-3, 1e-3)
"""Changes by which a predictor is probed: position [m], velocity [m/s], force [N]."""
LONGEST = 512
"""Most ticks for which one change is followed."""
FADED = 1e-3
"""Share of the largest answer below which an answer has faded."""
RIGID = 1e6
"""Stiffness over the coupling's of what the tool rests on while a predictor is probed."""
SETTLING = 300
"""Ticks of a contact at rest before a predictor is probed."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Forecast:
    """How the predicted force answers what was seen: F(t) = sum over ages a of taps . (x, v, F)(t -
    a).

    Attributes
    ----------
    taps
        Answers, shape (phases, ages, 3), to position [N/m], velocity [N s/m] and force [N/N]; the
        phase is that of the tick in which it was seen, counted from the last one in which the model
        gave its force; later phases see none.
    gain
        C of F + C (F_ahead - F): 0 plays the force as it is, 1 the one that is ahead.
    stiffness_N_m
        Of the coupling that the predictor was shown, with which its answers to place and speed
        grow; None for one that is shown none.
    """

    taps: Array
    gain: float = 1.0
    stiffness_N_m: float | None = None

    def __eq__(self, other: object) -> bool:
        """By value, so that a loop that was judged with another copy of the same predictor is
        not judged again.
        """
        return isinstance(other, Forecast) and self._value == other._value

    def __hash__(self) -> int:
        return hash(self._value)

    @cached_property
    def _value(self) -> tuple[bytes, tuple[int, ...], float, float | None]:
        return self.taps.tobytes(), self.taps.shape, self.gain, self.stiffness_N_m

    @property
    def memory(self) -> tuple[int, int]:
        """How many positions and forces before the present ones it takes."""
        ages = self.taps.shape[1]
        return ages if self.taps[:, :, :2].any() else 0, ages


_forecasts: Kept["Forecast"] = Kept(64)
"""Those of a study's methods in some tens of trials."""


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
    """Linearise a predictor about a contact at rest, by small changes of what it is shown.

    What was found for a predictor with the same contents is kept: a scene is judged again and
    again, by its stiffness, for its run and for its reference.

    Parameters
    ----------
    predictor
        It is copied and stays as it is.
    lead_ticks
        How far ahead it is asked.
    stiffness_N_m, depth_m
        Of the contact: the force is their product.
    model_ticks
        Ticks between two forces that it observes.
    axis
        Direction out of the tissue, unit, shape (3,); z without it.
    gain
        See `Forecast`.

    Raises
    ------
    InputError
        If a change is not forgotten: the predictor is no stable filter there.
    """
    out = np.array([0.0, 0.0, 1.0]) if axis is None else np.asarray(axis, dtype=np.float64)
    try:
        contents = pickle.dumps(predictor)
    except (
        TypeError,
        AttributeError,
        pickle.PicklingError,
    ):  # one of a user's own that cannot be compared with another
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
    """The same, found anew."""
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
    """Forces predicted along the axis from a settled state on, one of what is seen being changed
    in one tick [N].
    """
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
    """Answers up to where they have faded."""
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
