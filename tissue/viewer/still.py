"""Pictures of a window for a page: with a scale bar, or what was simulated alone on a transparent ground."""

from collections.abc import Collection
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissue.figures.marks import round_length
from tissue.viewer.camera import aim
from tissue.viewer.plotter import Plotter

__all__ = ["add_scale_bar", "leave_alone", "write_clean"]

PLACE_PX = (40, 380)
"""Lower left end of a scale bar [pixel]."""
LONGEST = 0.15
"""Longest scale bar, as a share of the window's width."""
BORDER = 0.02
"""Free border of a clean picture before it is cropped, as a share of its edges."""
FINE, AROUND_PX = 2, 8
"""Pixels along each edge of a clean picture for one of the window, and how many are left around what it shows."""


def add_scale_bar(plotter: Plotter) -> None:
    """Draw a bar of a round length in a window with a parallel projection."""
    import pyvista
    from vtkmodules.vtkRenderingCore import vtkActor2D, vtkPolyDataMapper2D

    camera = plotter.camera
    wide, tall = plotter.window_size
    per_mm = tall / (2.0 * camera.parallel_scale)
    length = round_length(LONGEST * wide / per_mm)
    x, y = PLACE_PX
    mapper = vtkPolyDataMapper2D()
    mapper.SetInputData(pyvista.Line((x, y, 0.0), (x + length * per_mm, y, 0.0)))
    mapper.ScalarVisibilityOff()
    bar = vtkActor2D()
    bar.SetMapper(mapper)
    bar.GetProperty().SetColor(0.1, 0.1, 0.1)
    bar.GetProperty().SetLineWidth(5.0)
    plotter.add_actor(bar, reset_camera=False, render=False)
    plotter.add_text(f"{length:g} mm", position=(x, y + 8), font_size=11, color="black")


def leave_alone(plotter: Plotter, kept: Collection[object], points_mm: NDArray[np.float64]) -> None:
    """Take away text, widgets, scales and all actors but some, and let the points fill the window."""
    plotter.clear_slider_widgets()
    plotter.remove_legend(render=False)
    plotter.remove_chart(*plotter.renderer._charts)
    for actor in list(plotter.actors.values()):
        if actor not in kept:
            plotter.remove_actor(actor, reset_camera=False, render=False)
    aim(plotter, points_mm, margins=(BORDER, 1.0 - BORDER, BORDER, 1.0 - BORDER), parallel=True)


def write_clean(plotter: Plotter, file: Path) -> None:
    """Write what is shown as PNG on a transparent ground, cropped to it."""
    from PIL import Image

    drawn = np.asarray(plotter.screenshot(None, return_img=True, transparent_background=True, scale=FINE))
    there = np.argwhere(drawn[..., 3] > 0)
    if len(there):
        (top, left), (low, right) = np.maximum(there.min(axis=0) - AROUND_PX, 0), there.max(axis=0) + AROUND_PX + 1
        drawn = drawn[top:low, left:right]
    Image.fromarray(drawn).save(file, dpi=(300, 300))
