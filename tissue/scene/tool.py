"""What a scene states of the tool that meets the tissue, and of how it moves."""

import math
from typing import Annotated, Literal

from pydantic import Field, Strict, model_validator

from meshes.base.errors import InputError
from tissue.scene.anatomy import Part, Vector
from tissue.scene.choices import OneOf
from tissue.scene.registry import CUTTERS, NEEDLES, PROBES

__all__ = ["Needle", "PathMotion", "Probe", "ReplayMotion", "ThrustMotion", "Tool"]


class Tool(Part):
    """A rotating cutter: a surface of revolution with flutes."""

    kind: Annotated[str, OneOf(CUTTERS)] = Field(examples=["ball-burr"])
    """Shape of the cutter."""
    diameter_mm: float = Field(gt=0.1, le=100, examples=[6.0])
    """Greatest diameter."""
    flutes: int = Field(4, ge=1, le=200)
    """Cutting edges around the axis."""
    spin_rpm: float = Field(ge=-500_000, le=500_000, examples=[500.0])
    """Spin, clockwise as seen from the shank, the sense of common burs, drills and reamers; a negative one is
    counter-clockwise. A tool that does not turn (0) cuts nothing: a hand on a device feels the bone with it."""
    length_mm: float = Field(10.0, gt=0, le=200)
    """Length of a cylinder, pear or drill, thickness of a flat reamer."""
    point_angle_deg: float = Field(118.0, ge=30, lt=180)
    """Included point angle of a twist drill."""
    peg_diameter_mm: float = Field(0.0, ge=0, le=20)
    """Diameter of a reamer's guide peg; 0 has none."""
    peg_length_mm: float = Field(0.0, ge=0, le=50)
    """How far the peg reaches beyond the tip."""
    shell_spacing_mm: float | None = Field(None, gt=0, le=10, examples=[0.2])
    """Distance between the cutter's elements; without it as wide as gives 6000 elements."""

    @property
    def can_have_peg(self) -> bool:
        """Whether it is a reamer."""
        return "peg_diameter_mm" in CUTTERS[self.kind].keys

    @model_validator(mode="after")
    def _spins_and_peg_fits(self) -> "Tool":
        if 0.0 < abs(self.spin_rpm) < 1.0:
            raise InputError(
                f"tool.spin_rpm must be at least 1 in size, or 0 for a tool that only touches, got {self.spin_rpm:g}: "
                "use 500"
            )
        if self.can_have_peg and self.peg_diameter_mm >= self.diameter_mm:
            raise InputError(
                f"tool.peg_diameter_mm must be below tool.diameter_mm ({self.diameter_mm:g}), got "
                f"{self.peg_diameter_mm:g}: use {0.2 * self.diameter_mm:g}"
            )
        return self


class Probe(Part):
    """A smooth tool that presses: a ball, the flat end of a cylinder, or any closed surface."""

    kind: Annotated[str, OneOf(PROBES)] = Field(examples=["sphere-probe"])
    """Shape of the probe."""
    diameter_mm: float = Field(20.0, ge=0.5, le=100)
    """Diameter of the ball or cylinder."""
    length_mm: float = Field(40.0, gt=0, le=200)
    """Length of a cylinder."""
    file: str | None = Field(None, examples=["finger.stl"])
    """Closed surface of a shell probe; the file's origin is the tip, z points to the shank."""
    scale_mm: float = Field(1.0, gt=0, le=1e5)
    """Millimetres per unit of that file."""

    @model_validator(mode="after")
    def _has_its_file(self) -> "Probe":
        if "file" in PROBES[self.kind].keys and self.file is None:
            raise InputError(f"tool.file must be given for a {self.kind}, got nothing: add the surface's file")
        return self


class Needle(Part):
    """A needle that pierces; its friction and cutting force are those of the tissue's table."""

    kind: Annotated[str, OneOf(NEEDLES)] = "needle"
    """A needle."""
    diameter_mm: float = Field(1.27, ge=0.2, le=5)
    """Outer diameter, 1.27 mm for 18 gauge; it scales nothing but the crack's width."""


class Motion(Part):
    """What every motion has."""

    axis: Vector = (0.0, 0.0, 1.0)
    """Direction of the tool's axis from tip to shank."""

    @model_validator(mode="after")
    def _axis_has_length(self) -> "Motion":
        if math.hypot(*self.axis) < 1e-9:
            raise InputError("motion.axis must have a length, got (0, 0, 0): use [0, 0, 1]")
        return self


class PathMotion(Motion):
    """The tip follows straight lines at a given feed, then stays at the end."""

    kind: Literal["path"] = "path"
    """Position-driven."""
    points_mm: Annotated[tuple[Vector, ...], Strict(False)] = Field(
        min_length=2, examples=[((0.0, 0.0, 0.5), (0.0, 0.0, -2.0))]
    )
    """Where the tip goes, corner by corner, in the frame of the site."""
    feed_mm_s: float = Field(gt=0, le=1000, examples=[1.0])
    """Speed of the tip."""


class ThrustMotion(Motion):
    """A given thrust pushes the tool along its axis; the feed follows from the balance with the cutting force."""

    kind: Literal["thrust"] = "thrust"
    """Force-driven."""
    start_mm: Vector = (0.0, 0.0, 0.5)
    """Where the tip starts, in the frame of the site."""
    thrust_N: float = Field(gt=0, le=1000, examples=[40.0])
    """Push along the tool's axis."""
    mass_kg: float = Field(0.5, gt=0, le=20)
    """Mass that moves with the tool."""
    max_feed_mm_s: float = Field(5.0, gt=0, le=200)
    """Feed the hand allows in free space."""
    depth_mm: float = Field(2.0, gt=0, le=100)
    """Travel from the face (z = 0 of the site) at which the feed stops."""


class ReplayMotion(Motion):
    """Poses from a table with the columns of ``trace.csv``: time_s, tool_x_mm ... tool_qw; or from a recording."""

    kind: Literal["replay"] = "replay"
    """Recorded."""
    file: str = Field(examples=["runs/glenoid/trace.csv"])
    """CSV table of poses, such as a run's own trace, or an HDF5 recording of volumetric_drilling."""
