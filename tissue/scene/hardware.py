"""What a scene states of a real device: where it is, how its axes lie in the scene, and what
protects the hand.
"""

from typing import Annotated

from pydantic import Field, model_validator

from meshes.base.errors import InputError
from tissue.scene.part import Part, Vector

__all__ = ["Hardware"]

Button = Annotated[int, Field(ge=0, le=31)]


class Hardware(Part):
    """How a real device is opened, and how its workspace lies in the scene;
    ``coupling.motion_scale`` is its scale.
    """

    address: str = Field("", max_length=1000, examples=["ws://localhost:10001"])
    """Where the device is, as its adapter takes it: an address, a serial number; empty for the
    usual place.
    """
    turn_deg: Vector = (0.0, 0.0, 0.0)
    """Turn of the device's axes into the world's: about the world's x, then y, then z."""
    clutch_button: Button | None = Field(None, examples=[1])
    """Button, 0 the first, that lets the device move without the tool while it is held; without
    it there is none.
    """
    force_button: Button | None = Field(None, examples=[0])
    """Button, 0 the first, that must be held for any force (dead man's switch); without it none
    has to be held.
    """
    force_cap_N: float | None = Field(None, gt=0, le=100, examples=[3.0])
    """Greatest force on the hand; without it the device's own limit."""
    ramp_ms: float = Field(500.0, ge=0, le=10_000)
    """Time in which the force comes on from zero: after the start, the clutch, the force button
    and a lost device.
    """
    watchdog_ms: float = Field(20.0, ge=2, le=1000)
    """Time without a new sample after which the force is zero."""

    @model_validator(mode="after")
    def _buttons_differ(self) -> "Hardware":
        if self.clutch_button is not None and self.clutch_button == self.force_button:
            raise InputError(
                "hardware.clutch_button",
                "not be hardware.force_button",
                f"{self.clutch_button} for both",
                "use another button for one of them",
            )
        return self
