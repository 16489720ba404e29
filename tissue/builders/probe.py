"""The probe that a scene's tool describes."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.errors import InputError, names_of_caller
from tissue.builders.parts import FILE_WORDS
from tissue.scene.tool import Probe as ProbeTable

if TYPE_CHECKING:
    from tissue.models.organ.probe import Probe, ShellProbe

__all__ = ["probe_of", "shell_note"]


def probe_of(tool: ProbeTable) -> "Probe":
    """The probe that a scene's tool describes.

    Raises
    ------
    InputError
        If its file is missing, or holds no closed surface.
    """
    from tissue.models.organ.probe import CylinderProbe, ShellProbe, SphereProbe

    radius = 0.5e-3 * tool.diameter_mm
    if tool.kind == "sphere-probe":
        return SphereProbe(radius)
    if tool.kind == "cylinder-probe":
        return CylinderProbe(radius, min(0.1 * radius, 5e-4))
    file = Path(tool.file or "")
    if not file.is_file():
        raise InputError(f"tool.file must exist, got {file}: check the path")
    try:
        with names_of_caller(dict.fromkeys(("mesh", *FILE_WORDS), "tool.file")):
            return ShellProbe.from_mesh(file, scale=1e-3 * tool.scale_mm)
    except InputError:
        raise
    except Exception as problem:  # trimesh's readers raise whatever their format's parser does
        raise InputError(
            f"tool.file must be a surface that can be read, got {file.name} (damaged or cut off): export it as STL"
        ) from problem


def shell_note(tool: ProbeTable, probe: "ShellProbe") -> str:
    """The unit in which a probe's file was taken, and the size that gives."""
    sides = " x ".join(f"{1e3 * side:.3g}" for side in np.ptp(probe.points_m, axis=0))
    return f"{Path(tool.file or '').name} taken at {tool.scale_mm:g} mm per unit: {sides} mm"
