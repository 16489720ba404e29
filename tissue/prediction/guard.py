"""Guard of a force predictor, which uses a fallback while predictions cannot be trusted."""

from collections import deque
from collections.abc import Callable
from copy import deepcopy
from math import ceil, isfinite, sqrt
from pathlib import Path
from traceback import extract_tb
from typing import Any, Protocol

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_positive
from tissue.prediction.predictor import Contact, Hold, Predictor, SeesContact
from tissue.prediction.trained import Trained

Triple = tuple[float, float, float]
BLEND = 10
"""Number of ticks in which the force fades between a predictor and its fallback."""
ABSURD = 1e6
"""Largest plausible component of a position [m], a velocity [m/s] or a force [N]."""
MEMORY = 0.98
"""Factor by which the weight of past prediction errors decays in a tick.

Errors are therefore averaged over about 50 ticks, the length of a first contact.
"""
WORSE = 1.5
"""Largest error of a trusted predictor, divided by the error of its fallback.

Smaller differences are treated as noise. The value is assumed and not measured.
"""
LEAST_N = 3e-3
"""Prediction error that is always accepted [N].

The value is less than a tenth of the lowest friction of a device, which is 0.04 N.
"""
LONG_MEMORY = 0.999
"""Factor by which past errors decay in a tick, in the comparison with the zero-order hold.

Errors are therefore compared over about 1 s. The comparison sums the squared errors of the
predictor minus the squared errors of the zero-order hold.
"""
MOST_DEBT = 20.0
"""Largest sum in the comparison with the zero-order hold, in units of `LEAST_N`^2.

From this limit, the sum decays to the accepted value `LEAST_N`^2 in three seconds if predictor and
zero-order hold have equal errors.
"""
PROBATION = 50
"""Number of ticks for which a predictor must be trusted before it is used again."""


class Judged(Predictor, Protocol):
    """Interface of a predictor that reports whether it can be trusted."""

    @property
    def trusted(self) -> bool:
        """True if the present prediction is within the range of the training data."""
        ...


class Guarded:
    """Force predictor with a fallback, which is used while the predictor is not trusted.

    The result is the fallback's force plus a weighted difference: the predictor's force minus the
    fallback's force. The predictor is no longer trusted in three cases. First, it reports that it
    is not trusted. Second, the recent errors of its predictions are larger than the errors of the
    fallback. Third, over a longer time, its errors are larger than the errors of a zero-order hold.
    In the third case, predicted contacts that did not happen also count as errors. When trust is
    lost, the weight of the difference falls from 1 to 0 within `BLEND` ticks, so that the force
    does not jump. After `PROBATION` ticks of trust, the weight increases at the same rate. The
    difference is limited to ``reach_N``. If the difference is not finite, the last finite
    difference is used.

    Parameters
    ----------
    inner
        Predictor to guard.
    instead
        Fallback predictor, used while the inner predictor is not trusted.
    reach_N
        Limit of the difference between the forces of predictor and fallback [N].
    """

    residual_N = 0.0
    is_primary = True

    def __init__(self, inner: Judged, instead: Predictor, *, reach_N: float) -> None:
        self.inner = inner
        self.instead = instead
        self._shown = [each for each in (inner, instead) if isinstance(each, SeesContact)]
        self._reach = require_positive("reach_N", reach_N, "use the device's largest force")
        self._share = 1.0
        self._good = PROBATION
        self._difference: Triple = (0.0, 0.0, 0.0)
        self._kept: deque[tuple[Triple, Triple, Triple]] = deque()
        self._lead = 0.0
        self._asked = False
        self._seen = (0.0, 0.0, 0.0)
        self._age = 0
        self._missed = [0.0, 0.0]
        self._over_held = 0.0

    def meet(self, contact: Contact) -> None:
        """Pass the contact to the predictor and to the fallback, if they use contacts."""
        for each in self._shown:
            each.meet(contact)

    def observe(self, position_m: Array, velocity_m_s: Array, force_N: Array | None) -> None:
        """Pass the sample to predictor and fallback, and update whether the predictor is trusted.

        An implausible or non-finite sample is treated as missing.
        """
        if not (_sane(position_m) and _sane(velocity_m_s) and (force_N is None or _sane(force_N))):
            self.pause()
            return
        self._asked = False
        self._missed = [MEMORY * self._missed[0], MEMORY * self._missed[1]]
        self._over_held *= LONG_MEMORY
        self._age += 1
        if force_N is not None:
            self._compare(force_N)
        self.inner.observe(position_m, velocity_m_s, force_N)
        self.instead.observe(position_m, velocity_m_s, force_N)
        self.residual_N = self.inner.residual_N
        primary, other = self._missed
        # The errors are mean squares, so that the limits are squared.
        worse = not (primary <= WORSE**2 * other + LEAST_N**2 and self._over_held <= LEAST_N**2)
        self._good = self._good + 1 if self.inner.trusted and not worse else 0
        change = 1.0 / BLEND
        self._share = (
            min(self._share + change, 1.0)
            if self._good >= PROBATION
            else max(self._share - change, 0.0)
        )
        self.is_primary = self._share > 0.5

    def predict(self, ticks: float) -> Array:
        """Return the blended force of predictor and fallback after a number of ticks."""
        # Three scalars are faster than arrays.
        u, v, w = self.inner.predict(ticks).tolist()
        x, y, z = self.instead.predict(ticks).tolist()
        u = u - x
        v = v - y
        w = w - z
        size = u * u + v * v + w * w
        # If a force is not finite, the last difference is used. A difference larger than the
        # device's force limit is shortened to this limit.
        if not isfinite(size):
            u, v, w = self._difference
        elif size > self._reach**2:
            share = self._reach / sqrt(size)
            u = u * share
            v = v * share
            w = w * share
        self._difference = u, v, w
        if not self._asked and ticks:
            self._keep(ticks, (x + u, y + v, z + w), (x, y, z))
        share = self._share
        return np.array((x + share * u, y + share * v, z + share * w))

    def _compare(self, force_N: Array) -> None:
        """Add the errors of earlier predictions for the present tick, whose force is now known."""
        fx, fy, fz = force_N.tolist()
        now = fx, fy, fz
        if self._lead and len(self._kept) == ceil(self._lead):
            kept = self._kept[0]
            # The time of the prediction is between the last two observed forces, so that they are
            # interpolated.
            back = (len(self._kept) - self._lead) / self._age
            bx, by, bz = self._seen
            fx = fx + back * (bx - fx)
            fy = fy + back * (by - fy)
            fz = fz + back * (bz - fz)
            primary, other, held = [
                (fx - x) ** 2 + (fy - y) ** 2 + (fz - z) ** 2 for x, y, z in kept
            ]
            self._over_held = min(
                self._over_held + (1.0 - LONG_MEMORY) * (primary - held), MOST_DEBT * LEAST_N**2
            )
            # If the fallback's force or the measured force is zero, there is no contact, or the
            # contact begins or ends. The predictors are not compared in such ticks.
            if any(kept[1]) and any(now):
                self._missed[0] += (1.0 - MEMORY) * primary
                self._missed[1] += (1.0 - MEMORY) * other
        self._seen = now
        self._age = 0

    def _keep(self, ticks: float, primary: Triple, safe: Triple) -> None:
        """Store the forces of predictor and fallback until the predicted force is observed."""
        self._asked = True
        if ticks != self._lead:
            self._lead = ticks
            self._kept = deque(maxlen=ceil(ticks))
        self._kept.append((primary, safe, self._seen))

    def pause(self) -> None:
        """Pause predictor and fallback, and discard the stored predictions."""
        self._kept.clear()
        self.inner.pause()
        self.instead.pause()


def _sane(vector: Array) -> bool:
    """Return True if the three numbers are finite and plausible."""
    x, y, z = vector.tolist()
    return abs(x) < ABSURD and abs(y) < ABSURD and abs(z) < ABSURD


class Observes(Protocol):
    """Minimal interface of a force predictor.

    Three optional members are used if they exist. ``pause()`` is called after a missing sample.
    ``trusted`` is False while the prediction should not be used. ``meet(contact)`` receives the
    contact of the tool in a tick (`tissue.prediction.predictor.Contact`). Before a run, a copy of
    the predictor is tested to check that the haptic loop is stable. After a small change of its
    input, the predictor's response must decay within half a second. The method `predict` is called
    more than once in a tick and must not change the predictor.
    """

    def observe(self, position_m: Array, velocity_m_s: Array, force_N: Array | None) -> None:
        """Update with position [m], velocity [m/s] and force [N] of the device, each of shape (3,).

        The force is the present force on the device. In a tick without a new force from the tissue,
        `force_N` is None.
        """
        ...

    def predict(self, ticks: float) -> Array:
        """Return the predicted force [N], shape (3,), `ticks` ticks after the last observation."""
        ...


class Outside:
    """Wrapper that adds missing optional members to an external predictor.

    The external predictor needs only the methods `observe` and `predict`. The wrapper's attribute
    ``residual_N`` is the magnitude of the last error of a prediction one tick ahead.

    Parameters
    ----------
    inner
        External predictor.
    name
        Name of the predictor in messages.

    Raises
    ------
    InputError
        If a method of the predictor raises an error, or if the predictor cannot be copied. The
        message names the predictor.
    """

    is_primary = True

    def __init__(self, inner: Observes, name: str) -> None:
        self.inner = inner
        self.name = name
        self._pause: Callable[[], object] | None = getattr(inner, "pause", None)
        if callable(meet := getattr(inner, "meet", None)):
            self.meet = meet
        self.residual_N = 0.0
        self._seen = False

    @property
    def trusted(self) -> bool:
        """True if the predictor reports that it is trusted.

        A predictor without the attribute ``trusted`` always counts as trusted.
        """
        return bool(getattr(self.inner, "trusted", True))

    def observe(self, position_m: Array, velocity_m_s: Array, force_N: Array | None) -> None:
        """Pass copies of a sample to the predictor."""
        force = None if force_N is None else force_N.copy()
        if force is not None and self._seen:
            missed = self.predict(1.0) - force
            self.residual_N = float(np.sqrt(missed @ missed))
        try:
            self.inner.observe(position_m.copy(), velocity_m_s.copy(), force)
        except Exception as error:
            raise _failed(self.name, "observe", error) from error
        self._seen = self._seen or force is not None

    def predict(self, ticks: float) -> Array:
        """Return a copy of the predictor's force."""
        try:
            force = np.array(self.inner.predict(ticks), dtype=np.float64)
        except Exception as error:
            raise _failed(self.name, "predict", error) from error
        if force.shape != (3,):
            raise InputError(
                f"predict of the predictor {self.name}",
                "return three forces in newtons",
                f"shape {force.shape}",
                "fix predict",
            )
        return force

    def pause(self) -> None:
        """Pause the predictor if it has the method ``pause``."""
        if self._pause is not None:
            self._pause()

    def __deepcopy__(self, memo: dict[int, Any]) -> "Outside":
        copied = Outside(copy_of(self.inner, self.name, memo), self.name)
        copied.residual_N = self.residual_N
        copied._seen = self._seen
        return copied


def copy_of(predictor: Any, name: str, memo: dict[int, Any] | None = None) -> Any:
    """Return a copy of an external predictor.

    Raises
    ------
    InputError
        If the predictor cannot be copied.
    """
    try:
        return deepcopy(predictor, memo)
    except Exception as error:
        raise InputError(
            f"predictor {name}",
            "support copying by copy.deepcopy",
            f"{type(error).__name__}: {error}",
            "remove attributes such as locks and open files, or define __deepcopy__",
        ) from error


def _failed(name: str, method: str, error: Exception) -> InputError:
    """Return the error for a method of a predictor that raised an error."""
    frames = extract_tb(error.__traceback__)
    # The first frame is the call in this module.
    place = f" in {Path(frames[-1].filename).name}, line {frames[-1].lineno}" if frames[1:] else ""
    return InputError(
        f"predictor {name}",
        f"run {method} without an error",
        f"{type(error).__name__}{place}: {error}",
        f"fix {method}",
    )


class GuardedMaker:
    """Factory that makes an external predictor and guards it (`Guarded`).

    The fallback of the guard is the zero-order hold.

    Parameters
    ----------
    name
        Name of the predictor.
    make
        Function that makes the predictor. If `trained` is True, its argument is the `Trained` data
        of the scene.
    trained
        Whether `make` is called with the trained data. If False, it is called without arguments.
    """

    def __init__(self, name: str, make: Callable[..., Any], *, trained: bool = False) -> None:
        self.name = name
        self.make = make
        self.trained = trained

    def __call__(self, trained: Trained | None, force_limit_N: float) -> Predictor:
        """Return a new predictor for a device with a given force limit [N]."""
        try:
            inner = self.make(trained) if self.trained else self.make()
        except InputError:
            raise
        except Exception as error:
            given = "with a Trained" if self.trained else "without arguments"
            raise InputError(
                f"predictor {self.name}",
                "be made without an error",
                f"{type(error).__name__}: {error}",
                f"fix its constructor, which is called {given}",
            ) from error
        missing = [
            each for each in ("observe", "predict") if not callable(getattr(inner, each, None))
        ]
        if missing:
            raise InputError(
                f"predictor {self.name}",
                "have observe and predict",
                f"{type(inner).__name__} without {' and '.join(missing)}",
                "see `tissue.prediction.guard.Observes`",
            )
        return Guarded(Outside(inner, self.name), Hold(), reach_N=force_limit_N)
