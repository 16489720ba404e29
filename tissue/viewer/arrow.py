"""A force as an arrow at the tool's tip, with its size beside it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["ForceArrow"]

FORCE = "#0072B2"
LEAST = 1e-3
"""Share of the greatest force that is not drawn any more."""


class ForceArrow:
    """An arrow as long as the force is great.

    Parameters
    ----------
    plotter
        Where it is shown.
    longest_mm
        Length of the arrow of the greatest force [mm].
    """

    def __init__(self, plotter: Any, *, longest_mm: float) -> None:
        import pyvista
        from vtkmodules.vtkRenderingCore import vtkBillboardTextActor3D

        self._longest = longest_mm
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

    def show(self, tip_mm: NDArray[np.float64], force_N: NDArray[np.float64], *, greatest_N: float) -> None:
        """Draw a force [N] that begins at a point [mm], beside the greatest one [N]."""
        import pyvista

        size = float(np.linalg.norm(force_N))
        shown = size > LEAST * max(greatest_N, 1e-9)
        self._arrow.SetVisibility(shown)
        self._value.SetVisibility(shown)
        if not shown:
            return
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
