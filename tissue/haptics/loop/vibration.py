"""Vibration of a cutter's teeth, cues at events, and last stages of a force to the device."""

from fractions import Fraction
from math import cos, inf, lcm, pi, sin, sqrt
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.arrays import Array
from tissue.haptics import hand_measures as at
from tissue.haptics.loop.filters import ForceRange, LowPass
from tissue.models.tissue_model import TICK_S, Response

if TYPE_CHECKING:
    from tissue.perception.perceived import Perception

BAND_LIMIT_HZ = 250.0
"""Highest frequency of the vibration [Hz]: a quarter of the tick rate.

Vibration is felt best near this frequency (Pacinian receptors).
"""
ENVELOPE_S = 0.05
"""Averaging time of the force [s]; the vibration is proportional to the averaged force.

A haptic loop may oscillate at 10 Hz and above. The averaging reduces the amplitude of such an
oscillation to a third or less. The reduced oscillation returns to the loop at frequencies near 250
Hz, at which hand and device hardly move.
"""
MOST_PERIOD_TICKS = 200
"""Longest period of a vibration in the stability analysis of a loop [ticks].

At 1 kHz, this limit allows frequencies from 5 Hz. A frequency is then rounded by at most 0.5 %.
"""
SLEW_SHARE = 0.5
"""Share of the device's slew rate that the vibration may use.

The other half is left for the force without vibration, because a loop at its slew limit oscillates.
"""


class Vibration:
    """Zero-mean vibration of a cutter's teeth, proportional to the average force.

    A cutter with N edges that turns omega / 2 pi times per second causes a force ripple at f = N
    omega / 2 pi. If a ripple with f above R / 2 were sampled at the tick rate R, aliasing would
    cause a false slow force. Its frequency would be the difference between f and the nearest
    multiple of R. The model force is therefore the average over a revolution, without ripple. The
    vibration is added at the frequency f, or at `BAND_LIMIT_HZ` if f is higher.

    Parameters
    ----------
    tooth_passing_Hz
        Tooth passing frequency [Hz].
    share
        Amplitude of the vibration divided by the average force.
    step_s
        Length of a tick [s].
    """

    def __init__(self, tooth_passing_Hz: float, *, share: float, step_s: float) -> None:
        self.frequency_Hz = min(tooth_passing_Hz, BAND_LIMIT_HZ)
        self.share = share
        self._turns = self.frequency_Hz * step_s

    def factor(self, tick: int) -> float:
        """Return the vibration at a tick, divided by the average force."""
        return self.share * cos(2.0 * pi * self._turns * tick)

    def period(self, model_ticks: int = 1) -> Array:
        """Return vibration divided by average force, over a common period of vibration and model.

        The common period is n steps of the tissue model. The result has shape (model_ticks, n).

        If the period of the vibration is longer than `MOST_PERIOD_TICKS` ticks, the nearest
        vibration with a shorter period is used.
        """
        # A vibration below half the lowest frequency would be rounded to zero periods.
        turns = Fraction(self._turns).limit_denominator(MOST_PERIOD_TICKS) or Fraction(
            1, MOST_PERIOD_TICKS
        )
        ticks = np.arange(lcm(turns.denominator, model_ticks)) % turns.denominator
        return self.share * np.cos(2.0 * pi * float(turns) * ticks).reshape(-1, model_ticks).T


class PlayedVibration:
    """Vibration that is added to the force of a device, within the limits of the device.

    The vibration is F_v = share E cos(2 pi f t). E is the force F averaged with a time constant tau
    of 0.05 s: dE/dt = (F - E) / tau. Within a period of the vibration, E is nearly constant. The
    vibration therefore hardly depends on the state of the loop. If the force changes at the
    frequency g, the vibration changes at the frequencies f - g and f + g. On this path, the
    amplitude of the change is multiplied by at most share / sqrt(1 + (2 pi g tau)^2). Two limits
    reduce the amplitude of the vibration. The sum of force and vibration stays within the largest
    force of the device. The vibration uses at most half of the slew rate, because a loop at its
    slew limit oscillates. The stability analysis (`tissue.haptics.loop.sampled_loop`) includes the
    vibration without these limits.

    Parameters
    ----------
    vibration
        Vibration with its frequency and its share.
    limit_N, slew_N
        Largest force of the device, and largest change of the force in a tick [N].
    """

    def __init__(self, vibration: Vibration, *, limit_N: float, slew_N: float = inf) -> None:
        self._vibration = vibration
        self._limit = limit_N
        # 2 sin(pi f T) is the largest change of a unit sine at f within a tick.
        self._most = SLEW_SHARE * slew_N / (2.0 * sin(pi * vibration.frequency_Hz * TICK_S))
        self._envelope = LowPass(ENVELOPE_S, step_s=TICK_S)
        self._tick = 0

    def step(self, force_N: Array) -> Array:
        """Return the vibration [N], shape (3,), for a tick with the device force ``force_N``."""
        self._tick += 1
        level = self._envelope.step(force_N)
        amplitude = self._vibration.share * sqrt(level.dot(level))
        most = min(self._most, max(self._limit - sqrt(force_N.dot(force_N)), 0.0))
        factor = self._vibration.factor(self._tick)
        return level * (factor if amplitude <= most else factor * most / amplitude)

    def pause(self) -> None:
        """Reset the averaged force after a tick without a valid sample."""
        self._tick += 1
        self._envelope.value = np.zeros(3)


CUE_HZ = 125.0
"""Frequency of the transient of a cue [Hz].

The frequency lies within the band of vibration receptors, 50 to 500 Hz (Johansson and Flanagan,
2009). The frequency is an eighth of the tick rate, so that the sampled transient is smooth.
"""
PERIODS = 5
"""Number of oscillations of a transient, which has a Hann window as envelope."""
APART_S = 0.1
"""Time without contact after which a contact counts as a first contact [s].

The value is also the shortest time between two transients.

A transient takes 40 ms, so two transients never overlap. A tool that bounces causes only one
transient.
"""
SETTLED_S = 0.01
"""Time for which a new layer must have the largest contact area, to count as a change [s].

At a border between two layers, the contact areas of both layers are nearly equal. Without this
time, the layer with the larger area could change in every tick.
"""


class TouchEvents:
    """Detector of first contacts and of changes of layer, from the contact area of each layer.

    A puncture also counts as a change of layer, from a membrane to the tissue behind it.
    """

    def __init__(self) -> None:
        self._apart = round(APART_S / TICK_S)
        self._settled = round(SETTLED_S / TICK_S)
        self._free = self._quiet = self._apart
        self._layer = -1
        self._for = 0

    def step(self, engaged_m2: Array) -> bool:
        """Update with the contact area of each layer [m2], and return True if an event begins."""
        self._quiet += 1
        layer = int(engaged_m2.argmax())
        if not engaged_m2[layer] > 0.0:
            self._free += 1
            return False
        first = self._free >= self._apart
        self._free = 0
        self._for = self._for + 1 if layer != self._layer else 0
        changed = self._layer >= 0 and self._for >= self._settled
        if first or changed:
            self._layer = layer
            self._for = 0
        if not (first or changed) or self._quiet < self._apart:
            return False
        self._quiet = 0
        return True


class Cues:
    """Force transients that signal touch events, along the direction of the device force.

    The mean of a transient is zero. After its start, a transient does not depend on the force, so
    it does not affect the stability of the loop.

    Parameters
    ----------
    amplitude_N
        Largest force of a transient [N].
    limit_N, slew_N
        Largest force of the device, and largest change of the force in a tick [N]. The transient is
        reduced to stay within these limits.
    """

    def __init__(self, amplitude_N: float, *, limit_N: float, slew_N: float) -> None:
        count = round(PERIODS / (CUE_HZ * TICK_S))
        # A sine of whole periods under a Hann window. Its mean is subtracted, so that the hand is
        # not displaced.
        at = (np.arange(count) + 0.5) / count
        burst = np.sin(2.0 * pi * PERIODS * at) * np.sin(pi * at) ** 2
        # The largest change of a unit sine within a tick, as in `PlayedVibration`.
        most = SLEW_SHARE * slew_N / (2.0 * sin(pi * CUE_HZ * TICK_S))
        self._burst = (min(amplitude_N, most) * (burst - burst.mean())).tolist()
        self._events = TouchEvents()
        self._limit = limit_N
        self._left = 0
        self._along = np.zeros(3)

    def step(self, force_N: Array, response: Response) -> Array:
        """Return the transient [N], shape (3,), to add to the device force ``force_N``."""
        if self._events.step(response.engaged_m2):
            self._left = len(self._burst)
            self._along = np.zeros(3)
        if not self._left:
            return np.zeros(3)
        size = sqrt(force_N.dot(force_N))
        # In the first tick of a contact the force may be zero and have no direction. The transient
        # then waits.
        if not self._along.any() and size > 0.0:
            self._along = force_N / size
        if not self._along.any():
            return np.zeros(3)
        left_N = max(self._limit - size, 0.0)
        value = self._burst[-self._left]
        self._left -= 1
        return min(max(value, -left_N), left_N) * self._along

    def pause(self) -> None:
        """End a running transient, because a sample is missing."""
        self._left = 0


class PlayedForce:
    """Last stages through which a force passes before it is sent to the device.

    Every stage except the compression to the range of the device is optional.

    Parameters
    ----------
    force_limit_N
        Largest force of the device [N].
    perception
        Perception model that scales the force. With None, the force is not scaled.
    vibration
        Vibration of the cutter's teeth, which is added to the force.
    cues
        Transients at first contacts, changes of layer and punctures, which are added to the force.

    Attributes
    ----------
    names
        Names of the trace columns that these stages write.
    measures
        Values of these columns in this tick.
    """

    def __init__(
        self,
        force_limit_N: float,
        *,
        perception: "Perception | None" = None,
        vibration: PlayedVibration | None = None,
        cues: Cues | None = None,
    ) -> None:
        self._person = perception
        self._vibration = vibration
        self._cues = cues
        self._range = ForceRange(limit_N=force_limit_N)
        parts = ((perception, at.PERCEIVED), (vibration, at.VIBRATION), (cues, at.CUE))
        self.names = tuple(name for part, names in parts if part is not None for name in names)
        self.measures = np.zeros(len(self.names))

    def step(self, force_N: Array, response: Response) -> tuple[Array, bool]:
        """Return the device force [N], shape (3,), and True if the range compressed it.

        Raises
        ------
        InputError
            If the force is not finite.
        """
        measures: list[float] = []
        wanted = force_N
        if (person := self._person) is not None:
            wanted = person.step(wanted)
            measures += (
                person.estimated_N,
                person.perceived,
                person.perceived_spread,
                person.above,
            )
        wanted, compressed = self._range.play(wanted)
        if self._vibration is not None:
            shaken = self._vibration.step(wanted)
            measures += shaken.tolist()
            wanted = wanted + shaken
        if self._cues is not None:
            cue = self._cues.step(wanted, response)
            measures += cue.tolist()
            wanted = wanted + cue
        self.measures[:] = measures
        return wanted, compressed

    def pause(self) -> None:
        """Reset all stages after a tick that had neither a valid device sample nor a force."""
        for part in (self._person, self._vibration, self._cues):
            if part is not None:
                part.pause()
        self.measures[len(at.PERCEIVED) * (self._person is not None) :] = 0.0
