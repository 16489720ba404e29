"""What a scene changes in the force so that people discriminate forces better, at a stated cost of fidelity."""

from pydantic import Field, model_validator

from meshes.base.errors import InputError
from tissue.scene.part import Part

__all__ = ["Enhancement"]


class Enhancement(Part):
    """Changes to the device's force that help to discriminate forces; each is off unless it is set."""

    tuned: bool = False
    """Whether lift and contrast are chosen for the person of perception, within a slope of 2."""
    lift: float = Field(1.0, ge=1, le=6, examples=[2.0])
    """Slope by which weak forces are lifted, falling to 1 for strong ones; 1 lifts none."""
    lift_below_N: float = Field(1.0, ge=0.05, le=10)
    """Force at the device about which the lift ends."""
    contrast: float = Field(1.0, ge=1, le=1.5, examples=[1.25])
    """Exponent of the force about its slowly adapting mean; 1 leaves contrasts as they are."""
    contrast_s: float = Field(2.0, ge=0.5, le=60)
    """Time constant with which that mean adapts."""
    cue_N: float = Field(0.0, ge=0, le=1, examples=[0.3])
    """Amplitude of the transient at first contact, another layer and a puncture; 0 plays none."""

    @model_validator(mode="after")
    def _asks_for_something(self) -> "Enhancement":
        if not self.tuned and self.lift == self.contrast == 1.0 and self.cue_N == 0.0:
            raise InputError(
                "enhancement must change something, got nothing: use lift = 1.5, contrast = 1.25, cue_N = 0.3 or "
                "tuned = true"
            )
        return self
