"""External predictors: a complete predictor made from one with two methods."""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.prediction.guard import Guarded
from tissue.prediction.predictor import Hold, Predictor
from tissue.prediction.trained import Trained

__all__ = ["GuardedMaker", "Observes", "Outside"]


class Observes(Protocol):
    """Minimal interface of a force predictor.

    Three optional members are used where they exist. ``pause()`` is called after a missing sample.
    ``trusted`` is false while the prediction should not be played. ``meet(contact)`` receives the
    contact of the tool in a tick (`tissue.prediction.contact.Contact`). The predictor is copied and
    probed before a run, to check the stability of the loop: its response to a small change must
    fade within half a second. `predict` must not change the predictor. It is called more than once
    a tick.
    """

    def observe(self, position_m: Array, velocity_m_s: Array, force_N: Array | None) -> None:
        """Update with the device's position [m] and velocity [m/s], shape (3,), and the force [N].

        The force acts on the device. It is None in a tick without a force.
        """
        ...

    def predict(self, ticks: float) -> Array:
        """Predict the force a number of ticks after the last observation [N], shape (3,)."""
        ...


class Outside:
    """Complete predictor around one that has only `observe` and `predict`.

    Its last error is the force it expected one tick ahead minus the observed force.

    Parameters
    ----------
    inner
        The predictor.
    name
        Name of the predictor in messages.
    """

    is_primary = True

    def __init__(self, inner: Observes, name: str) -> None:
        self.inner = inner
        self._name = name
        self._pause: Callable[[], object] | None = getattr(inner, "pause", None)
        if callable(meet := getattr(inner, "meet", None)):
            self.meet = meet
        self.residual_N = 0.0
        self._seen = False

    @property
    def trusted(self) -> bool:
        """Trust as the predictor reports it.

        A predictor without ``trusted`` is always trusted, and only the guard judges it.
        """
        return bool(getattr(self.inner, "trusted", True))

    def observe(self, position_m: Array, velocity_m_s: Array, force_N: Array | None) -> None:
        """Pass copies of a sample to the predictor."""
        force = None if force_N is None else force_N.copy()
        if force is not None and self._seen:
            missed = self.predict(1.0) - force
            self.residual_N = float(np.sqrt(missed @ missed))
        self.inner.observe(position_m.copy(), velocity_m_s.copy(), force)
        self._seen = self._seen or force is not None

    def predict(self, ticks: float) -> Array:
        """Return a copy of the predictor's force."""
        force = np.array(self.inner.predict(ticks), dtype=np.float64)
        if force.shape != (3,):
            raise InputError(
                f"predict of the predictor {self._name}",
                "return three newtons",
                f"shape {force.shape}",
                "fix it",
            )
        return force

    def pause(self) -> None:
        """Pause a predictor that has the method."""
        if self._pause is not None:
            self._pause()


class GuardedMaker:
    """Factory of an external predictor under the guard.

    The fallback of the guard is the zero-order hold.

    Parameters
    ----------
    name
        Its name.
    make
        Function that makes it, called with the data trained for the scene, or without arguments.
    trained
        Call `make` with the trained data.
    """

    def __init__(self, name: str, make: Callable[..., Any], *, trained: bool = False) -> None:
        self.name = name
        self.make = make
        self.trained = trained

    def __call__(self, trained: Trained | None, force_limit_N: float) -> Predictor:
        """Return a new predictor for a device with a given force limit [N]."""
        inner = self.make(trained) if self.trained else self.make()
        missing = [
            each for each in ("observe", "predict") if not callable(getattr(inner, each, None))
        ]
        if missing:
            raise InputError(
                f"predictor {self.name}",
                "have observe and predict",
                f"{type(inner).__name__} without {' and '.join(missing)}",
                "see `tissue.prediction.outside.Observes`",
            )
        return Guarded(Outside(inner, self.name), Hold(), reach_N=force_limit_N)
