"""Last stages of force rendering: perceptual scaling, device range, vibration and cues."""

import numpy as np

from meshes.base.arrays import Array
from tissue.haptics import hand_measures as at
from tissue.haptics.device.device import DeviceParameters
from tissue.haptics.loop.filters import ForceRange
from tissue.haptics.loop.vibration import Cues, PlayedVibration
from tissue.models.tissue_model import Response
from tissue.perception.perceived import Perception

__all__ = ["PlayedForce"]


class PlayedForce:
    """Last stages of a force before the device. Every stage except the range is optional.

    Parameters
    ----------
    limits
        Provides the largest force of the device.
    perception
        Perception model that scales the force. Without it, the force is not scaled.
    vibration
        Vibration of the cutter's teeth, added to the played force.
    cues
        Transients of contact, layers and punctures, added to the played force.

    Attributes
    ----------
    names
        Columns of the trace.
    measures
        Values of these columns in this tick.
    """

    def __init__(
        self,
        limits: DeviceParameters,
        *,
        perception: Perception | None = None,
        vibration: PlayedVibration | None = None,
        cues: Cues | None = None,
    ) -> None:
        self._person = perception
        self._vibration = vibration
        self._cues = cues
        self._range = ForceRange(limit_N=limits.force_limit_N)
        perceived = at.PERCEIVED if perception is not None else ()
        shaken = at.VIBRATION if vibration is not None else ()
        cued = at.CUE if cues is not None else ()
        self.names = (*perceived, *shaken, *cued)
        self.measures = np.zeros(len(self.names))
        self._perceived = slice(0, len(perceived))
        self._shaken = slice(self._perceived.stop, self._perceived.stop + len(shaken))
        self._cued = slice(self._shaken.stop, self._shaken.stop + len(cued))

    def step(self, force_N: Array, response: Response) -> tuple[Array, bool]:
        """Return the force to play [N], shape (3,), and whether the device's range compressed it.

        Raises
        ------
        InputError
            If the force is not finite.
        """
        row = self.measures
        wanted = force_N
        if (person := self._person) is not None:
            wanted = person.step(wanted)
            row[self._perceived] = (
                person.estimated_N,
                person.perceived,
                person.perceived_spread,
                person.above,
            )
        wanted, compressed = self._range.play(wanted)
        if self._vibration is not None:
            row[self._shaken] = shaken = self._vibration.step(wanted)
            wanted = wanted + shaken
        if self._cues is not None:
            cue = self._cues.step(wanted, response)
            row[self._cued] = cue
            wanted = wanted + cue
        return wanted, compressed

    def pause(self) -> None:
        """Reset all stages after a tick without a valid device sample and a played force."""
        for part in (self._person, self._vibration, self._cues):
            if part is not None:
                part.pause()
        self.measures[self._shaken.start :] = 0.0
