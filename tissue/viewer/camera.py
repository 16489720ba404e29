"""The camera of `tissue view`: from the front and above, with what is shown between the texts and the chart."""

import numpy as np
from numpy.typing import NDArray

from tissue.viewer.plotter import Plotter

__all__ = ["aim"]

EYE, UP = (0.25, -0.75, 0.8), (0.0, 0.35, 1.0)
MARGINS = (0.2, 0.86, 0.36, 0.88)
"""Left, right, lower and upper end of the area for the scene, in shares of the window."""


def aim(
    plotter: Plotter,
    points_mm: NDArray[np.float64],
    *,
    margins: tuple[float, float, float, float] = MARGINS,
    parallel: bool = False,
) -> None:
    """Look down from the front so that the points fill the area; without points so that all that there is does.

    A parallel projection has one scale everywhere, which a scale bar needs.
    """
    plotter.camera.parallel_projection = parallel
    plotter.camera.SetWindowCenter(0.0, 0.0)
    plotter.camera_position = [EYE, (0.0, 0.0, 0.0), UP]
    plotter.reset_camera()
    left, right, low, high = margins
    if not len(points_mm):
        plotter.camera.SetWindowCenter(0.0, 1.0 - (low + high))
        return
    wide, tall = plotter.window_size
    matrix = plotter.camera.GetCompositeProjectionTransformMatrix(wide / tall, -1.0, 1.0)
    view = np.array([[matrix.GetElement(row, column) for column in range(4)] for row in range(4)])
    seen = np.column_stack([points_mm, np.ones(len(points_mm))]) @ view.T
    seen = seen[:, :2] / seen[:, 3:]  # -1 to 1 across the window
    first, last = seen.min(axis=0), seen.max(axis=0)
    share = 2.0 * np.array([right - left, high - low])
    zoom = float((share / np.maximum(last - first, 1e-9)).min())
    plotter.camera.zoom(zoom)
    middle = np.array([left + right, low + high]) - 1.0
    plotter.camera.SetWindowCenter(*(0.5 * zoom * (first + last) - middle))
