"""What a scene states of a procedural lumbar vertebra."""

from typing import Literal

from pydantic import Field, model_validator

from meshes.base.errors import InputError
from tissue.scene.anatomy import AnatomyFile

__all__ = ["VertebraAnatomy"]


class VertebraAnatomy(AnatomyFile):
    """A lumbar vertebra. Origin behind its left pedicle, +z outward along the pedicle's axis, +y up.

    Its structure `canal`, for `keep_clear.names`, lies at +x.
    """

    kind: Literal["vertebra"] = "vertebra"
    """A lumbar vertebra, L4 by default."""
    body_width_mm: float = Field(48.0, ge=36, le=60)
    """Width of the body."""
    body_depth_mm: float = Field(34.5, ge=26, le=45)
    """Depth of the body, front to back."""
    body_height_mm: float = Field(25.0, ge=20, le=34)
    """Height of the body."""
    canal_width_mm: float = Field(25.4, ge=16, le=32)
    """Width of the spinal canal."""
    canal_depth_mm: float = Field(18.6, ge=11, le=26)
    """Depth of the spinal canal, front to back."""
    pedicle_width_mm: float = Field(12.9, ge=5, le=22)
    """Width of the pedicle; more than three times its cortex."""
    pedicle_height_mm: float = Field(14.8, ge=8, le=22)
    """Height of the pedicle."""
    pedicle_angle_deg: float = Field(17.7, ge=0, le=35)
    """By which the pedicle leans to the middle toward the front."""
    pedicle_cortex_mm: float = Field(1.0, ge=0.3, le=3)
    """Thickness of the cortex of pedicle and arch."""

    @model_validator(mode="after")
    def _is_procedural(self) -> "VertebraAnatomy":
        if self.file is not None:
            raise InputError(f"anatomy.file must be left out for a vertebra, got {self.file}: use kind = bone")
        return self
