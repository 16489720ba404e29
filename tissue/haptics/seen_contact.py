"""What a loop shows a predictor of the contact behind the force of a tick."""

from meshes.base.arrays import Array
from tissue.haptics.proxy.cutting_tool import CuttingTool
from tissue.haptics.proxy.held_tool import HeldTool
from tissue.models.tissue_model import Response
from tissue.prediction.contact import Contact

__all__ = ["seen_contact"]


def seen_contact(
    tool: HeldTool, stiffness_N_m: float, scale: float, shift_m: Array, response: Response
) -> Contact:
    """The contact at the device: a length there is one at the tool over m, a force f times as
    great.

    Parameters
    ----------
    tool
        On its spring.
    stiffness_N_m
        Stiffness of the coupling at the device; it is m f of the tool's.
    scale, shift_m
        The device at x has the tool at m x + shift [m], shape (3,).
    response
        The tissue's answer to the tool.
    """
    felt = stiffness_N_m / (scale * tool.stiffness_N_m)
    known = response.stiffness_N_m
    return Contact(
        stiffness_N_m,
        (tool.tip_m - shift_m) / scale,
        felt * response.wrench[:3],
        None if known is None else (scale * felt) * known,
        response.gap_m / scale,
        response.normal,
        isinstance(tool, CuttingTool),
    )
