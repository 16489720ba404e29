"""The probe that a scene's tool describes."""

from pathlib import Path
from typing import TYPE_CHECKING

from meshes.errors import InputError
from tissue.scene_tool import Probe as ProbeTable

if TYPE_CHECKING:
    from tissue.liver.probe import Probe

__all__ = ["probe_of"]


def probe_of(tool: ProbeTable) -> "Probe":
    """The probe that a scene's tool describes.

    Raises
    ------
    InputError
        If its file is missing, or holds no closed surface.
    """
    from tissue.liver.probe import CylinderProbe, ShellProbe, SphereProbe

    radius = 0.5e-3 * tool.diameter_mm
    if tool.kind == "sphere-probe":
        return SphereProbe(radius)
    if tool.kind == "cylinder-probe":
        return CylinderProbe(radius, min(0.1 * radius, 5e-4))
    file = Path(tool.file or "")
    if not file.is_file():
        raise InputError(f"tool.file must exist, got {file}: check the path")
    try:
        return ShellProbe.from_mesh(file, scale=1e-3 * tool.scale_mm)
    except InputError as error:
        raise InputError(f"tool.file: {error}") from error
    except Exception as problem:  # trimesh's readers raise whatever their format's parser does
        why = type(problem).__name__
        raise InputError(
            f"tool.file must be a surface that can be read, got {file.name} ({why}): export it as STL"
        ) from problem
