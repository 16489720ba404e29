"""From the force that a loop has found to the one that a device plays: enhanced, scaled, in range, with cues."""

import numpy as np

from meshes.base.arrays import Array
from tissue.haptics import hand_measures as at
from tissue.haptics.device.device import DeviceParameters
from tissue.haptics.loop.cues import Cues
from tissue.haptics.loop.filters import ForceRange
from tissue.haptics.loop.vibration import PlayedVibration
from tissue.models.tissue_model import Response
from tissue.perception.enhancement import EnhancedForce
from tissue.perception.perception import Perception

__all__ = ["PlayedForce"]


class PlayedForce:
    """The last stages of a force before its device, each of which may be left out.

    Parameters
    ----------
    limits
        Gives the device's greatest force.
    enhancement
        Lifts weak forces and makes contrasts stronger.
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
        enhancement: EnhancedForce | None = None,
        perception: Perception | None = None,
        vibration: PlayedVibration | None = None,
        cues: Cues | None = None,
    ) -> None:
        self._enhancement, self._person, self._vibration, self._cues = enhancement, perception, vibration, cues
        self._range = ForceRange(limit_N=limits.force_limit_N)
        enhanced = enhancement is not None or cues is not None
        stages = (at.PERCEIVED, perception is not None), (at.VIBRATION, vibration is not None), (at.ENHANCED, enhanced)
        self.names = tuple(name for names, there in stages if there for name in names)
        self.measures = np.zeros(len(self.names))
        people = len(at.PERCEIVED) if perception is not None else 0
        self._people, self._shaken = slice(0, people), slice(people, people + len(at.VIBRATION))
        self._enhanced = slice(len(self.names) - len(at.ENHANCED), len(self.names)) if enhanced else slice(0, 0)

    def step(self, force_N: Array, response: Response) -> tuple[Array, bool]:
        """The force that is played for one at the device [N], shape (3,), and whether the device's range compressed it.

        Raises
        ------
        InputError
            If the force is not finite.
        """
        row, wanted = self.measures, force_N
        if self._enhancement is not None:
            wanted = self._enhancement.step(wanted)
        enhanced = wanted
        if (person := self._person) is not None:
            wanted = person.step(wanted)
            row[self._people] = person.estimated_N, person.perceived, person.perceived_spread, person.above
        wanted, compressed = self._range.play(wanted)
        if self._vibration is not None:
            row[self._shaken] = shaken = self._vibration.step(wanted)
            wanted = wanted + shaken
        if self._cues is not None:
            cue = self._cues.step(wanted, response)
            wanted, enhanced = wanted + cue, enhanced + cue
        if self._enhanced.stop:
            row[self._enhanced] = enhanced
        return wanted, compressed

    def pause(self) -> None:
        """Nothing is known of the device in this tick, and nothing is played."""
        for part in (self._person, self._vibration, self._cues):
            if part is not None:
                part.pause()
        if self._vibration is not None:
            self.measures[self._shaken] = 0.0
        self.measures[self._enhanced] = 0.0
