"""Rigid tools that press an organ: balls, punches and tools from files."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from meshes.base.errors import names_of_caller, require_positive, require_range
from meshes.base.hints import suggests_arguments

if TYPE_CHECKING:
    import pyvista

    from tissue.models.organ.probe import ProbeShape
    from tissue.scene.tool import Probe

SIZES_MM = (0.5, 100.0)
"""Smallest and largest diameter of a probe in a scene [mm]."""


@dataclass(frozen=True, eq=False)
class PressingTool:
    """Rigid tool that presses an organ; made by `ball`, `flat_punch` or `probe_from_file`."""

    probe: Probe
    name: str

    def __repr__(self) -> str:
        return self.name

    @cached_property
    def shape(self) -> ProbeShape:
        """Shape of the tool for the contact computation."""
        from tissue.simulation.builders.organ_scene import probe_of

        keys = {f"tool.{key}": key for key in ("file", "scale_mm", "diameter_mm")}
        with names_of_caller(keys):
            return probe_of(self.probe)

    @property
    def surface(self) -> pyvista.PolyData:
        """Surface in the frame of the tool [mm]: tip at the origin, z axis from tip to shank."""
        from tissue.show.figures.tool_mesh import tool_surface

        drawn = tool_surface(self.probe)
        assert drawn is not None
        return drawn


@suggests_arguments
def ball(*, diameter_mm: float) -> PressingTool:
    """Return a rigid ball as a pressing tool.

    >>> import tissue
    >>> tissue.ball(diameter_mm=12)
    ball(diameter_mm=12)
    """
    return _round("sphere-probe", "ball", diameter_mm)


@suggests_arguments
def flat_punch(*, diameter_mm: float) -> PressingTool:
    """Return a rigid cylinder with a flat end and a rounded edge.

    The edge radius is a tenth of the cylinder's radius, but not more than 0.5 mm.

    >>> import tissue
    >>> tissue.flat_punch(diameter_mm=8)
    flat_punch(diameter_mm=8)
    """
    return _round("cylinder-probe", "flat_punch", diameter_mm)


@suggests_arguments
def probe_from_file(file: str | Path, *, scale_mm: float = 1.0) -> PressingTool:
    """Read a rigid pressing tool from a file with a closed surface.

    In the frame of the file, the tip must be at the origin, and the z axis must point to the shank.

    Parameters
    ----------
    file
        Path of an STL, OBJ, PLY, VTK or VTP file.
    scale_mm
        Millimetres per unit of length in the file.

    Raises
    ------
    InputError
        If the file is missing or holds no closed surface.
    """
    from tissue.scene.tool import probe_part

    scale = require_positive("scale_mm", scale_mm, "use 1 for millimetres, 1000 for metres")
    stated = probe_part(kind="shell-probe", file=str(file), scale_mm=scale)
    tool = PressingTool(stated, f"probe_from_file({str(file)!r}, scale_mm={scale:g})")
    tool.shape  # noqa: B018 - what cannot be used is refused here
    return tool


def _round(kind: str, name: str, diameter_mm: float) -> PressingTool:
    from tissue.scene.tool import probe_part

    diameter = require_range("diameter_mm", diameter_mm, *SIZES_MM, "use about 16 for a fingertip")
    return PressingTool(
        probe_part(kind=kind, diameter_mm=diameter), f"{name}(diameter_mm={diameter:g})"
    )
