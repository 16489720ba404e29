"""A predictor from outside the package: two methods, and what else a loop asks of one made of
them.
"""

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
    """The least that predicts a force.

    What it has besides is used: ``pause()`` after a sample that did not come, ``trusted``, false
    while its prediction should not be played, and ``meet(contact)``, which shows it what the tool
    touches in a tick (`tissue.prediction.contact.Contact`). It is copied and probed before a run,
    to judge the loop: its answer to a small change must fade within half a second. `predict`
    changes nothing, and is asked more than once a tick.
    """

    def observe(self, position_m: Array, velocity_m_s: Array, force_N: Array | None) -> None:
        """Take in the device's position [m] and velocity [m/s], shape (3,), and the force on it
        [N], or None.
        """
        ...

    def predict(self, ticks: float) -> Array:
        """Force to be expected so many ticks after the last observation [N], shape (3,)."""
        ...


class Outside:
    """A whole predictor around one with `observe` and `predict` alone.

    Its last error is what it expected a tick ahead less the force that came.

    Parameters
    ----------
    inner
        The predictor.
    name
        What messages call it.
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
        """What the predictor states of itself; without that it is trusted, and the guard alone
        judges.
        """
        return bool(getattr(self.inner, "trusted", True))

    def observe(self, position_m: Array, velocity_m_s: Array, force_N: Array | None) -> None:
        """Pass a sample on, as copies."""
        force = None if force_N is None else force_N.copy()
        if force is not None and self._seen:
            missed = self.predict(1.0) - force
            self.residual_N = float(np.sqrt(missed @ missed))
        self.inner.observe(position_m.copy(), velocity_m_s.copy(), force)
        self._seen = self._seen or force is not None

    def predict(self, ticks: float) -> Array:
        """Its force, as a copy."""
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
        """Pass it on to one that wants to know."""
        if self._pause is not None:
            self._pause()


class GuardedMaker:
    """Makes a predictor from outside under the guard, which holds the last force where it is not to
    be trusted.

    Parameters
    ----------
    name
        Its name.
    make
        Makes it: called with what was trained for the scene, or with nothing.
    trained
        Whether it is given what was trained.
    """

    def __init__(self, name: str, make: Callable[..., Any], *, trained: bool = False) -> None:
        self.name = name
        self.make = make
        self.trained = trained

    def __call__(self, trained: Trained | None, force_limit_N: float) -> Predictor:
        """A new one, for a device of so great a force [N]."""
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
