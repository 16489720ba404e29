"""What a scene says of the device in a person's hand, and of the wall that shows what the device can do."""

from typing import Annotated, Literal

from pydantic import Field

from tissue.scene_anatomy import Part

__all__ = [
    "Coupling", "DeviceName", "HandName", "PerceptionName", "PredictionName", "RendererName", "WallAnatomy",
]  # fmt: skip

DeviceName = Literal["none", "touch", "omni", "six-dof"]
HandName = Literal["novice", "intermediate", "expert"]
RendererName = Literal["penalty", "passivity", "proxy"]
PredictionName = Literal["none", "hold", "linear", "kalman", "dmdc", "koopman"]
PerceptionName = Annotated[str, Field(pattern=r"^(none|population|observer:.+)$", examples=["population"])]


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
    model_ms: int = Field(1, ge=1, le=100)
    """Time for which one answer of the tissue holds, in whole ticks; 10 is a model at 100 Hz."""
    predictor_file: str = ""
    """Trained predictor, as `tissue train` writes it; empty for the scene's own."""


class WallAnatomy(Part):
    """A stiff wall with its face at z = 0, for a ball to be pushed against."""

    kind: Literal["wall"] = "wall"
    """A wall."""
    stiffness_kN_m: float = Field(10.0, ge=1, le=40)
    """Stiffness of the wall, without friction or damping."""
