"""The enhancement that a scene asks for, with what is tuned to its person."""

from dataclasses import dataclass
from pathlib import Path

from meshes.base.errors import InputError
from tissue.haptics.device.device import DeviceParameters
from tissue.perception.enhancement import Contrast, Lift, steepest
from tissue.perception.observer import read_observer
from tissue.perception.population import population_observer
from tissue.perception.tuning import tuned_enhancement
from tissue.scene.enhancement import Enhancement
from tissue.scene.registry import PERCEPTIONS

__all__ = ["Enhancing", "enhancing"]


@dataclass(frozen=True, kw_only=True)
class Enhancing:
    """What is done to the device's force, as `tissue.scene.enhancement.Enhancement` states it.

    Attributes
    ----------
    lift, contrast
        Of the force's size.
    cue_N
        Amplitude of transients [N].
    """

    lift: Lift
    contrast: Contrast
    cue_N: float

    @property
    def maps(self) -> bool:
        """Whether the force's size is changed at all."""
        return self.lift.gain > 1.0 or self.contrast.exponent > 1.0

    @property
    def steepest(self) -> float:
        """Greatest slope of the changed force over the force."""
        return steepest(self.lift, self.contrast)

    @property
    def sentence(self) -> str:
        """What is done, in words."""
        parts = []
        if self.lift.gain > 1.0:
            parts.append(f"forces below {self.lift.below_N:g} N are lifted by up to {self.lift.gain:.3g}")
        if self.contrast.exponent > 1.0:
            parts.append(f"contrasts about the mean have the exponent {self.contrast.exponent:.3g}")
        if self.cue_N > 0.0:
            parts.append(f"contacts, layers and punctures are marked by {self.cue_N:g} N")
        slope = f", at most {self.steepest:.3g} times as steep" if self.maps else ""
        return f"enhanced: {', '.join(parts) or 'nothing is to be gained for this person'}{slope}"


def enhancing(asked: Enhancement, perception: str, limits: DeviceParameters) -> Enhancing:
    """What a scene's enhancement does on a device, tuned to the person of a perception where it asks for that.

    Raises
    ------
    InputError
        If there is no observer to tune it to, or its file cannot be used.
    """
    contrast = Contrast(exponent=asked.contrast, adaptation_s=asked.contrast_s)
    lift = Lift(gain=asked.lift, below_N=asked.lift_below_N)
    if asked.tuned:
        name, argument = ("none", "") if perception == "none" else PERCEPTIONS.split(perception, "none")
        if name not in ("population", "observer:FILE"):
            raise InputError(
                f"perception must be population or observer:FILE for enhancement.tuned, got {perception}: "
                "choose one of these"
            )
        observer = read_observer(Path(argument)) if argument else population_observer()
        lift, contrast = tuned_enhancement(
            observer,
            force_limit_N=limits.force_limit_N,
            friction_N=limits.friction_N,
            adaptation_s=asked.contrast_s,
        )
    return Enhancing(lift=lift, contrast=contrast, cue_N=asked.cue_N)
