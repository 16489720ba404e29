"""Tools and motions, as tables of a scene.

The registries in `tissue.scene.names` state which keys each cutter and probe has.
"""

import math
from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, Strict, create_model

from meshes.base.errors import InputError
from tissue.scene.names import CUTTERS, NEEDLES, PROBES
from tissue.scene.part import FileName, Needs, OneOf, Part, Vector, kinds_of

CUTTER_KEYS: dict[str, Any] = {
    "length_mm": (
        float,
        Field(10.0, gt=0, le=200, description="Length, or thickness of a flat reamer."),
    ),
    "point_angle_deg": (float, Field(118.0, ge=30, lt=180, description="Included point angle.")),
    "web_mm": (
        float | None,
        Field(
            None,
            ge=0,
            le=20,
            examples=[0.5],
            description=(
                "Thickness of the web of a drill. The web forms the chisel edge. Default: 18 % of "
                "the diameter. With 0, the lips of the drill reach the axis and have a constant "
                "rake."
            ),
        ),
    ),
    "helix_deg": (
        float,
        Field(30.0, ge=0, le=60, description="Helix angle of the flutes of a drill."),
    ),
    "peg_diameter_mm": (
        Annotated[float, Needs("tool.peg_length_mm")],
        Field(
            0.0,
            ge=0,
            le=20,
            description="Diameter of the guide peg of a reamer. With 0 there is no peg.",
        ),
    ),
    "peg_length_mm": (
        Annotated[float, Needs("tool.peg_diameter_mm")],
        Field(0.0, ge=0, le=50, description="Length of the guide peg beyond the tip."),
    ),
}
"""Types and limits of keys that define the shape of some cutters, besides the diameter."""
PROBE_KEYS: dict[str, Any] = {
    "diameter_mm": (
        float,
        Field(20.0, ge=0.5, le=100, description="Diameter of the ball or of the cylinder."),
    ),
    "length_mm": (float, Field(40.0, gt=0, le=200, description="Length of the cylinder.")),
    "file": (
        FileName,
        Field(
            examples=["finger.stl"],
            description=(
                "File of the closed surface of the probe. The origin of the file is the tip, and z "
                "points to the shank."
            ),
        ),
    ),
    "scale_mm": (
        float,
        Field(1.0, gt=0, le=1e5, description="Millimetres per unit of the probe's file."),
    ),
}
"""Types and limits of keys that define the shape of some probes."""
USUAL_PROBE_MM = 20.0
"""Diameter that mesh refinement assumes for a probe without a diameter [mm]; that of a fingertip.
"""


class Shaped(Part):
    """Base class of the tool classes that are made from registry entries."""

    kind: str
    """Shape of the tool."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the keys and values, because a class that is created at run time has no module."""
        return tool_of, (self.model_dump(exclude_unset=True),)


class Tool(Shaped):
    """A rotating cutter with flutes; its envelope is a surface of revolution.

    Concave cutters, such as cup reamers for a convex joint head, are not modelled.
    """

    diameter_mm: float = Field(gt=0.1, le=100, examples=[6.0])
    """Largest diameter."""
    flutes: Annotated[int, Needs("tool.spin_rpm")] = Field(4, ge=1, le=200)
    """Number of cutting edges around the tool's axis."""
    spin_rpm: float = Field(ge=-500_000, le=500_000, examples=[500.0])
    """Rotational speed, clockwise as seen from the shank, as for common burs, drills and reamers. A
    negative value is counter-clockwise. A tool with the value 0 cuts nothing; with a device, the
    user can then feel the uncut bone.
    """
    shell_spacing_mm: Annotated[float | None, Needs("tool.spin_rpm")] = Field(
        None, gt=0, le=10, examples=[0.2]
    )
    """Distance between the cutting elements, the small pieces into which the cutter's surface is
    divided.

    Default: the distance that gives 6000 cutting elements.
    """

    @property
    def peg_mm(self) -> tuple[float, float]:
        """Diameter and length of the guide peg [mm]; zeros without a peg."""
        return getattr(self, "peg_diameter_mm", 0.0), getattr(self, "peg_length_mm", 0.0)

    def without_peg(self) -> "Tool":
        """Return a copy of the cutter without guide peg and with default `shell_spacing_mm`."""
        pegs: dict[str, Any] = {
            name: 0.0
            for name in ("peg_diameter_mm", "peg_length_mm")
            if name in type(self).model_fields
        }
        return self.model_copy(update={**pegs, "shell_spacing_mm": None})

    def require_valid(self) -> None:
        """Check the spin, and check that web and guide peg are thin enough for the diameter."""
        # At such a low spin, chips would be thicker than the tool at any feed.
        if 0.0 < abs(self.spin_rpm) < 1.0:
            raise InputError(
                "tool.spin_rpm",
                "be 0, at least 1 or at most -1",
                f"{self.spin_rpm:g}",
                "use a value such as 500, or 0 for a tool that only touches",
            )
        web_mm = getattr(self, "web_mm", None) or 0.0
        if web_mm > 0.5 * self.diameter_mm:
            raise InputError(
                "tool.web_mm",
                f"be at most half of tool.diameter_mm = {self.diameter_mm:g}",
                f"{web_mm:g}",
                f"use a value such as {0.18 * self.diameter_mm:.3g}",
            )
        peg_mm, _ = self.peg_mm
        if peg_mm >= self.diameter_mm:
            raise InputError(
                "tool.peg_diameter_mm",
                f"be below tool.diameter_mm ({self.diameter_mm:g})",
                f"{peg_mm:g}",
                f"use a value such as {0.2 * self.diameter_mm:g}",
            )


class Probe(Shaped):
    """A smooth tool that presses: a ball, the flat end of a cylinder, or any closed surface."""

    @property
    def file_name(self) -> str:
        """File of the closed surface; empty for a ball or a cylinder."""
        return str(getattr(self, "file", ""))

    @property
    def scale(self) -> float:
        """Millimetres per length unit of the file."""
        return float(getattr(self, "scale_mm", 1.0))

    @property
    def size_mm(self) -> float:
        """Diameter of a ball or a cylinder [mm]; 20 mm (a fingertip) for any other probe."""
        return float(getattr(self, "diameter_mm", USUAL_PROBE_MM))


@cache
def _shaped(base: type[Shaped], kind: str, keys: tuple[str, ...]) -> type[Shaped]:
    """Return the class of a tool with the given keys."""
    shapes = CUTTER_KEYS if base is Tool else PROBE_KEYS
    word = kind.title().replace("-", "").replace("_", "")
    entries = {key: shapes[key] for key in keys}
    entries["kind"] = (
        Literal[kind],
        Field(description="Shape of the cutter." if base is Tool else "Shape of the probe."),
    )
    return create_model(word, __base__=base, __doc__=base.__doc__, **entries)


def tool_parts() -> "tuple[type[Part], ...]":
    """Return the classes of all known tools."""
    cutters = [_shaped(Tool, kind, CUTTERS[kind].keys) for kind in CUTTERS.known]
    probes = [_shaped(Probe, kind, PROBES[kind].keys) for kind in PROBES.known]
    return (*cutters, *probes, Needle, Blade)


def probe_part(**entries: Any) -> Probe:
    """Return the probe with the given keys, which include `kind`."""
    made = tool_of(entries)
    assert isinstance(made, Probe)
    return made


def tool_of(entries: dict[str, Any]) -> Shaped:
    """Return the cutter or probe with the given keys, which include `kind`."""
    kind = entries["kind"]
    if kind in CUTTERS:
        return _shaped(Tool, kind, CUTTERS[kind].keys)(**entries)
    return _shaped(Probe, kind, PROBES[kind].keys)(**entries)


class Needle(Part):
    """A needle that pierces tissue.

    The constants of the tissue determine the friction and the cutting force of the needle.
    """

    kind: Annotated[str, OneOf(NEEDLES)] = "needle"
    """A needle."""
    diameter_mm: float = Field(1.27, ge=0.2, le=5)
    """Outer diameter. An 18-gauge needle has 1.27 mm. The diameter affects only the width of the
    crack that the needle makes in the tissue.
    """


class Blade(Part):
    """A thin plate with a straight cutting edge, which cuts soft tissue.

    The plane of the blade contains the tool's x axis and z axis (the axis of the tool). The cutting
    edge begins at the tip.
    """

    kind: Literal["blade"] = "blade"
    """A blade."""
    width_mm: float = Field(6.0, ge=1, le=40)
    """Width of the blade, along the tool's x axis."""
    thickness_mm: float = Field(0.4, ge=0.05, le=2)
    """Thickness of the blade. It must be less than the width of the blade."""
    edge_deg: float = Field(45.0, ge=5, le=90)
    """Angle between the cutting edge and the tool's axis: 90 for a chisel, less for a pointed
    blade.
    """

    def require_valid(self) -> None:
        """Check that the blade is thinner than it is wide."""
        if self.thickness_mm >= self.width_mm:
            raise InputError(
                "tool.thickness_mm",
                f"be less than tool.width_mm ({self.width_mm:g})",
                f"{self.thickness_mm:g}",
                "use a value such as 0.4",
            )


class Motion(Part):
    """Motion with a fixed orientation of the tool."""

    axis: Vector = (0.0, 0.0, 1.0)
    """Direction of the tool's axis from tip to shank."""

    def require_valid(self) -> None:
        """Check that `axis` is not the zero vector."""
        # A vector that consists of rounding errors has no direction.
        if math.hypot(*self.axis) < 1e-9:
            raise InputError(
                "motion.axis", "not be zero", "(0, 0, 0)", "use a direction such as [0, 0, 1]"
            )


class PathMotion(Motion):
    """Motion of the tool's tip along straight lines at a given speed.

    After the last line, the tip stays at the end of the path.
    """

    drive: ClassVar[str] = "feed_mm_s"
    """Name of the key that determines the speed of the tool."""
    kind: Literal["path"] = "path"
    """Motion along a given path."""
    points_mm: Annotated[tuple[Vector, ...], Strict(False)] = Field(
        min_length=2, examples=[((0.0, 0.0, 0.5), (0.0, 0.0, -2.0))]
    )
    """Corners of the tip's path, in the frame of the scene. Consecutive corners must differ. To
    hold the tool still, use a recorded motion with times (`motion.kind = "replay"`).
    """
    feed_mm_s: float = Field(gt=0, le=1000, examples=[1.0])
    """Speed of the tip."""


class ThrustMotion(Motion):
    """Motion of the tool along its axis under a given axial force (thrust).

    The speed results from the balance of thrust and cutting force.
    """

    drive: ClassVar[str] = "thrust_N"
    kind: Literal["thrust"] = "thrust"
    """Motion under a given thrust."""
    start_mm: Vector = (0.0, 0.0, 0.5)
    """Start position of the tip, in the frame of the scene."""
    thrust_N: float = Field(gt=0, le=1000, examples=[40.0])
    """Thrust along the tool's axis."""
    mass_kg: float = Field(0.5, gt=0, le=20)
    """Mass of the tool and of everything that moves with it."""
    max_feed_mm_s: float = Field(5.0, gt=0, le=200)
    """Largest speed. The tool has this speed where it touches nothing."""
    depth_mm: float = Field(2.0, gt=0, le=100)
    """Depth of the tip below the surface (z = 0) at which the tool stops."""


class ReplayMotion(Part):
    """Motion through recorded poses from a file.

    A CSV file needs the columns time_s, tool_x_mm, tool_y_mm, tool_z_mm, tool_qx, tool_qy, tool_qz
    and tool_qw, as in ``trace.csv`` of a run.
    """

    kind: Literal["replay"] = "replay"
    """Recorded motion."""
    file: FileName = Field(examples=["runs/glenoid/trace.csv"])
    """CSV table of poses, such as the trace of a run, or an HDF5 recording of the simulator
    volumetric_drilling.
    """


def kept_entries(part: str, table: Mapping[str, object], kind: object) -> dict[str, object]:
    """Return the entries of a table that are kept if its kind changes.

    They are the entries of a cutter that another kind of cutter has, too, and the axis of a motion.
    The key ``shell_spacing_mm`` is not kept, because it was chosen for the shape of the old cutter.

    Parameters
    ----------
    part
        Name of the table: ``tool``, ``motion`` or another table, whose entries are not kept.
    table
        Table with the old kind.
    kind
        New kind.
    """
    kinds = {str(table["kind"]), str(kind)}
    has: set[str] = set()
    if part == "tool" and all(each in CUTTERS for each in kinds):
        has = {*Tool.model_fields, *CUTTERS[str(kind)].keys} - {"shell_spacing_mm"}
    if part == "motion" and kinds == {*kinds_of(PathMotion), *kinds_of(ThrustMotion)}:
        has = set(Motion.model_fields)
    return {key: value for key, value in table.items() if key in has}
