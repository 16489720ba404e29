"""Force on a human scale, tick by tick: map, deadband, estimate and intensity of one observer."""

from math import inf, sqrt

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.perception.deadband import Deadband
from tissue.perception.mapping import ForceMap
from tissue.perception.recursive import Sense

__all__ = ["PerceivedForce"]


class PerceivedForce:
    """The contract `tissue.perception.perception.Perception`: what shall be felt in, what to command out.

    Parameters
    ----------
    law
        Command for a force, and the intensity of a command.
    deadband
        Holds the command until its change can be felt.
    sense
        What the observer takes the command for.
    sentence
        Who feels, and what is done to the force for that; reported before a run.

    Attributes
    ----------
    steepest
        Greatest slope of command over force: a loop is as stable as on a wall that much stiffer.
    """

    def __init__(self, law: ForceMap, deadband: Deadband, sense: Sense, *, sentence: str) -> None:
        self.sentence, self.steepest = sentence, law.steepest
        self.law, self.deadband, self.sense = law, deadband, sense
        self.estimated_N = self.perceived = self.perceived_spread = self._size = 0.0
        self.above = False

    def step(self, force_N: Array) -> Array:
        """Force to command [N], shape (3,); the array is overwritten by the next step.

        Raises
        ------
        InputError
            If the force is not finite; nothing has changed then.
        """
        x, y, z = force_N.tolist()
        size = sqrt(x * x + y * y + z * z)
        if not size < inf:
            raise InputError(f"force must be finite, got {force_N}: hold it back with a SampleGuard")
        share = self.law.table.at(size) / size if size > 0.0 else 1.0
        deadband = self.deadband
        if deadband.step(share * x, share * y, share * z):
            a, b, c = deadband.held.tolist()
            self._size = sqrt(a * a + b * b + c * c)
            self.perceived = self.law.intensity.at(self._size)
            self.perceived_spread = self.law.spread.at(self._size)
        self.above = deadband.changed
        self.estimated_N = self.sense.step(self._size)
        return deadband.held

    def pause(self) -> None:
        """No sample came: nothing is commanded, and the next force counts as a change."""
        self.deadband.forget()
        self.above = False
