"""What a scene says of the device in a person's hand, and of the wall that shows what the device can do."""

from typing import Literal

from pydantic import Field

from tissue.scene_anatomy import Part

__all__ = ["Coupling", "DeviceName", "HandName", "RendererName", "WallAnatomy"]

DeviceName = Literal["none", "touch", "omni", "six-dof"]
HandName = Literal["novice", "intermediate", "expert"]
RendererName = Literal["penalty", "passivity", "proxy"]


class Coupling(Part):
    """How a device is coupled to the tool; of no effect without a device."""

    stiffness_N_m: float | None = Field(None, ge=1, le=1e5, examples=[400.0])
    """Stiffness at the device; without it half the critical one in that hand, at most the device's published limit."""
    damping_N_s_m: float = Field(0.0, ge=0, le=1000)
    """Damping at the device."""
    force_scale: float = Field(1.0, ge=1e-4, le=100)
    """Newtons at the device for each newton at the tool."""
    delay_ms: int = Field(0, ge=0, le=200)
    """Latency added on the way to the device, in whole ticks."""


class WallAnatomy(Part):
    """A stiff wall with its face at z = 0, for a ball to be pushed against."""

    kind: Literal["wall"] = "wall"
    """A wall."""
    stiffness_kN_m: float = Field(10.0, ge=1, le=40)
    """Stiffness of the wall, without friction or damping."""
