"""The tool in a window, and its force as an arrow at the tip with its size beside it and in words."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue.figures.tool_mesh import pose
from tissue.viewer.plotter import Plotter

if TYPE_CHECKING:
    import pyvista

__all__ = ["ToolShown"]

FORCE = "#0072B2"
LEAST = 1e-3
"""Share of the greatest force that is not drawn any more."""


class ToolShown:
    """A tool, and an arrow as long as its force is great.

    Parameters
    ----------
    plotter
        Where they are shown.
    tool
        Surface of the tool in its own frame [mm], or None.
    longest_mm
        Length of the arrow of the greatest force [mm].
    opacity
        Of the tool.
    """

    def __init__(self, plotter: Plotter, tool: "pyvista.PolyData | None", *, longest_mm: float, opacity: float) -> None:
        import pyvista
        from vtkmodules.vtkRenderingCore import vtkBillboardTextActor3D

        self._longest = longest_mm
        grey = {"color": "gray", "opacity": opacity, "specular": 0.4, "reset_camera": False}
        self._tool = None if tool is None else plotter.add_mesh(tool, **grey)
        self._arrow = plotter.add_mesh(pyvista.Arrow(), color=FORCE, reset_camera=False)
        self._value = vtkBillboardTextActor3D()
        look = self._value.GetTextProperty()
        look.SetFontSize(22)
        look.SetBold(True)
        look.SetColor(*pyvista.Color(FORCE).float_rgb)
        look.SetBackgroundColor(1.0, 1.0, 1.0)
        look.SetBackgroundOpacity(0.6)
        self._value.SetDisplayOffset(8, 4)
        plotter.add_actor(self._value, reset_camera=False, render=False)

    def show(
        self,
        tip_mm: NDArray[np.float64],
        turn: NDArray[np.float64],
        force_N: NDArray[np.float64],
        *,
        greatest_N: float,
    ) -> str:
        """Show the tool by its tip [mm] and turn (x, y, z, w), and its force [N] beside the greatest one, in words."""
        import pyvista

        if self._tool is not None:
            self._tool.user_matrix = pose(tip_mm, turn)
        size = float(np.linalg.norm(force_N))
        shown = size > LEAST * max(greatest_N, 1e-9)
        self._arrow.SetVisibility(shown)
        self._value.SetVisibility(shown)
        if shown:
            length = self._longest * size / greatest_N
            self._arrow.mapper.dataset = pyvista.Arrow(
                start=tip_mm,
                direction=force_N,
                scale=length,
                shaft_radius=0.02 * self._longest / length,
                tip_radius=0.05 * self._longest / length,
                tip_length=min(0.12 * self._longest / length, 0.6),
            )
            self._value.SetInput(f"{size:.3g} N")
            self._value.SetPosition(*(tip_mm + length * force_N / size))
        parts = ", ".join(f"{one:.2f}" for one in force_N.round(2) + 0.0)
        return f"force {size:.2f} N ({parts})"
