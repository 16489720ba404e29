"""Contact that the loop passes to a predictor together with the force of a tick."""

from meshes.base.arrays import Array
from tissue.haptics.proxy.cutting_tool import CuttingTool
from tissue.haptics.proxy.held_tool import HeldTool
from tissue.models.tissue_model import Response
from tissue.prediction.contact import Contact

__all__ = ["seen_contact"]


def seen_contact(
    tool: HeldTool, stiffness_N_m: float, scale: float, shift_m: Array, response: Response
) -> Contact:
    """Convert the contact at the tool to the contact at the device.

    Lengths at the device are lengths at the tool divided by m. Forces at the device are f times the
    forces at the tool, with f = ``stiffness_N_m`` / (m · tool stiffness).

    Parameters
    ----------
    tool
        Tool coupled to the device by a spring.
    stiffness_N_m
        Stiffness of the coupling at the device [N/m]. It is m f times the stiffness at the tool.
    scale, shift_m
        Scale m and shift [m], shape (3,): a device at x has the tool at m x + shift.
    response
        Tissue response to the tool.
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
