"""Scenes: frozen, validated descriptions of what to simulate.

A scene is a TOML file. Every quantity carries its unit in its name; anything unknown, missing, out of range or not
finite is refused with one sentence that names the key, the value, the requirement and a remedy.
"""

import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, Strict, model_validator

from meshes.errors import InputError
from tissue.scene_anatomy import BlockAnatomy, GlenoidAnatomy, MolarAnatomy, Part, Vector

__all__ = [
    "Cutting",
    "Output",
    "PathMotion",
    "ReplayMotion",
    "Scene",
    "Stress",
    "ThrustMotion",
    "Tool",
    "Voxels",
]


class Voxels(Part):
    """How the bone is divided and removed."""

    spacing_mm: float = Field(0.1, gt=0, le=2, examples=[0.1])
    """Edge of a voxel."""
    removal: Literal["subvoxel", "binary"] = "subvoxel"
    """Whether a voxel loses the part inside the tool, or all of itself once its centre is inside."""
    margin_mm: float = Field(3.0, ge=0.5, le=50)
    """Bone kept around what the tool can reach."""


class Tool(Part):
    """A rotating cutter: a surface of revolution with flutes."""

    kind: Literal["ball-burr", "pear-bur", "cylinder", "twist-drill", "hemispherical-reamer", "flat-reamer"] = Field(
        examples=["ball-burr"]
    )
    """Shape of the cutter."""
    diameter_mm: float = Field(gt=0.1, le=100, examples=[6.0])
    """Greatest diameter."""
    flutes: int = Field(4, ge=1, le=200)
    """Cutting edges around the axis."""
    spin_rpm: float = Field(ge=-500_000, le=500_000, examples=[500.0])
    """Spin about the axis from tip to shank by the right-hand rule; a common right-hand cutter turns negative."""
    length_mm: float = Field(10.0, gt=0, le=200)
    """Length of a cylinder, pear or drill, thickness of a flat reamer."""
    point_angle_deg: float = Field(118.0, ge=30, lt=180)
    """Included point angle of a twist drill."""
    peg_diameter_mm: float = Field(0.0, ge=0, le=20)
    """Diameter of a reamer's guide peg; 0 has none."""
    peg_length_mm: float = Field(0.0, ge=0, le=50)
    """How far the peg reaches beyond the tip."""
    shell_spacing_mm: float | None = Field(None, gt=0, le=10, examples=[0.2])
    """Distance between the cutter's elements; without it two voxels, or wider where that gives over 1600 elements."""

    @model_validator(mode="after")
    def _spins_and_peg_fits(self) -> "Tool":
        if abs(self.spin_rpm) < 1.0:
            raise InputError(
                f"tool.spin_rpm must be at least 1 in size, got {self.spin_rpm:g}: a tool that does not spin does not "
                "cut, use 500"
            )
        if self.peg_diameter_mm >= self.diameter_mm:
            raise InputError(
                f"tool.peg_diameter_mm must be below tool.diameter_mm ({self.diameter_mm:g}), got "
                f"{self.peg_diameter_mm:g}: use {0.2 * self.diameter_mm:g}"
            )
        return self


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
    """Poses from a table with the columns of ``trace.csv``: time_s, tool_x_mm ... tool_qw."""

    kind: Literal["replay"] = "replay"
    """Recorded."""
    file: str = Field(examples=["runs/glenoid/trace.csv"])
    """CSV table of poses, such as a run's own trace."""


class Cutting(Part):
    """Changes to the cited cutting coefficients of bone; empty entries keep the cited value."""

    tangential_chip_N_mm2: float | None = Field(None, ge=0, le=5000, examples=[150.0])
    """Chip force along the cutting speed, per area of the chip's section."""
    radial_chip_N_mm2: float | None = Field(None, ge=0, le=5000, examples=[60.0])
    """Chip force normal to the tool's surface, per area of the chip's section."""
    axial_chip_N_mm2: float | None = Field(None, ge=0, le=5000, examples=[0.0])
    """Chip force along the edge, per area of the chip's section."""
    tangential_edge_N_mm: float | None = Field(None, ge=0, le=500, examples=[5.0])
    """Edge force along the cutting speed, per length of the edge."""
    radial_edge_N_mm: float | None = Field(None, ge=0, le=500, examples=[4.0])
    """Edge force normal to the tool's surface, per length of the edge."""
    axial_edge_N_mm: float | None = Field(None, ge=0, le=500, examples=[0.0])
    """Edge force along the edge, per length of it."""
    density_exponent: float | None = Field(None, ge=0, le=5, examples=[1.5])
    """Power of the density over its reference that scales all coefficients."""


class Output(Part):
    """What is made of the model's force before it is commanded to a device."""

    low_pass_ms: float = Field(1.0, ge=0, le=1000)
    """Time constant of the low-pass y += (1 - exp(-T/a)) (u - y); 0 passes the model's force on."""
    vibration_share: float = Field(0.0, ge=0, le=1)
    """Amplitude of the teeth's vibration relative to the average force, rendered at 250 Hz at most."""


class Stress(Part):
    """Displacement and stress of a tooth by particle finite elements; a scene without it builds none."""

    cell_mm: float = Field(0.5, ge=0.2, le=1.5)
    """Edge of a cell; its half, the particles' spacing, must be a whole multiple of voxels.spacing_mm."""
    interval_ms: float = Field(100.0, ge=10, le=10_000)
    """Time between two solves; the stress belongs to a state at most this old."""


AnyAnatomy = Annotated[GlenoidAnatomy | BlockAnatomy | MolarAnatomy, Field(discriminator="kind")]
AnyMotion = Annotated[PathMotion | ThrustMotion | ReplayMotion, Field(discriminator="kind")]


class Scene(Part):
    """Everything one simulation needs; equal scenes give equal traces."""

    name: str = Field(pattern=r"^[a-z0-9][a-z0-9_-]*$", examples=["glenoid-2"])
    """Name of the scene and of the folder under runs/; lower-case letters, digits, - and _."""
    description: str = ""
    """What it models, in a line."""
    seed: int = Field(0, ge=0, lt=2**63)
    """Seed of every random draw."""
    duration_s: float | None = Field(None, ge=1e-3, le=3600, examples=[5.0])
    """Simulated time; without it as long as the motion lasts."""
    anatomy: AnyAnatomy
    """Bone to cut."""
    voxels: Voxels = Voxels()
    """How the bone is divided and removed."""
    tool: Tool
    """What cuts it."""
    motion: AnyMotion
    """How the tool moves."""
    cutting: Cutting = Cutting()
    """Changes to the cutting coefficients."""
    output: Output = Output()
    """What becomes of the force."""
    stress: Stress | None = None
    """Whether and how finely displacement and stress are computed."""
    heat: bool = False
    """Whether the temperature of a tooth and its pulp is computed."""

    @model_validator(mode="after")
    def _parts_fit(self) -> "Scene":
        hole, peg = self.anatomy.guide_hole_diameter_mm, self.tool.peg_diameter_mm
        if peg > 0.0 and (hole < peg or self.anatomy.guide_hole_depth_mm < self.tool.peg_length_mm):
            depth, length = self.anatomy.guide_hole_depth_mm, self.tool.peg_length_mm
            raise InputError(
                f"tool.peg_diameter_mm must fit the guide hole ({hole:g} mm wide, {depth:g} mm deep), got a peg of "
                f"{peg:g} x {length:g} mm: widen or deepen it by anatomy.guide_hole_diameter_mm and "
                "anatomy.guide_hole_depth_mm"
            )
        if self.tool.diameter_mm < 4.0 * self.voxels.spacing_mm:
            raise InputError(
                f"voxels.spacing_mm must be at most a quarter of tool.diameter_mm ({self.tool.diameter_mm:g}), got "
                f"{self.voxels.spacing_mm:g}: use {self.tool.diameter_mm / 20:g}"
            )
        if self.stress is not None:
            self._stress_fits(self.stress)
        if self.heat and self.anatomy.kind != "molar":
            raise InputError(f"heat must be false for a {self.anatomy.kind}, got true: it is for a molar")
        return self

    def _stress_fits(self, stress: Stress) -> None:
        if self.anatomy.kind != "molar":
            raise InputError(f"stress must be left out for a {self.anatomy.kind}, got a table: it is for a molar")
        spacing = self.voxels.spacing_mm
        ratio = 0.5 * stress.cell_mm / spacing
        if abs(ratio - round(ratio)) > 1e-6 or round(ratio) < 1:
            least, most = math.ceil(0.1 / spacing - 1e-6), math.floor(0.75 / spacing + 1e-6)
            fits = 2 * min(max(round(ratio), least), most) * spacing
            raise InputError(
                f"stress.cell_mm must be an even multiple of voxels.spacing_mm ({spacing:g}), got "
                f"{stress.cell_mm:g}: use {f'{fits:g}' if most > 0 else 'voxels.spacing_mm = 0.1'}"
            )

    def to_toml(self) -> str:
        """The whole scene, defaults included, as TOML."""
        import tomli_w

        return tomli_w.dumps(self.model_dump(mode="json", exclude_none=True))

    def with_files_at(self, folder: Path) -> "Scene":
        """The same scene with the paths of its files made absolute, relative ones taken from ``folder``."""
        changes: dict[str, Any] = {}
        for part in ("anatomy", "motion"):
            value: Part = getattr(self, part)
            names = [name for name in type(value).model_fields if name == "file" or name.endswith("_file")]
            files = {name: getattr(value, name) for name in names if getattr(value, name)}
            if files:
                absolute = {name: str((folder / file).resolve()) for name, file in files.items()}
                changes[part] = value.model_copy(update=absolute)
        return self.model_copy(update=changes)
