"""From the force that a loop has found to the one that a device plays: scaled, in range, with
vibration and cues.
"""

import numpy as np

from meshes.base.arrays import Array
from tissue.haptics import hand_measures as at
from tissue.haptics.device.device import DeviceParameters
from tissue.haptics.loop.cues import Cues
from tissue.haptics.loop.filters import ForceRange
from tissue.haptics.loop.vibration import PlayedVibration
from tissue.models.tissue_model import Response
from tissue.perception.perception import Perception

__all__ = ["PlayedForce"]


class PlayedForce:
    """The last stages of a force before its device, each of which may be left out.

    Parameters
    ----------
    limits
        Gives the device's greatest force.
    perception
        The person for whom the force is scaled; without it newtons stay newtons.
    vibration
        Of the cutter's teeth, added to what is played.
    cues
        Transients of contact, layers and punctures, added to what is played.

    Attributes
    ----------
    names
        Columns of the trace.
    measures
        Their values in this tick.
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
        """The force that is played for one at the device [N], shape (3,), and whether the device's
        range compressed it.

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
        """Nothing is known of the device in this tick, and nothing is played."""
        for part in (self._person, self._vibration, self._cues):
            if part is not None:
                part.pause()
        self.measures[self._shaken.start :] = 0.0
