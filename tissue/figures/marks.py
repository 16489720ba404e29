"""Marks upon a shaded picture: a scale bar in mm and the world's axes."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tissue.figures.rendering import Camera

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_axes", "draw_scale", "round_length"]

LENGTHS_MM = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)


def round_length(longest_mm: float) -> float:
    """The greatest round length of at most so many mm."""
    return max(step for step in LENGTHS_MM if step <= max(longest_mm, LENGTHS_MM[0]))


def draw_scale(axes: "Axes", camera: Camera) -> None:
    """A bar of a round length; the projection is parallel, so it holds across the picture."""
    from matplotlib.patheffects import withStroke

    per_mm = camera.size[1] / camera.height_mm
    length = round_length(0.25 * camera.size[0] / per_mm)
    x, y = camera.size[0] - 20.0, camera.size[1] - 16.0
    around = [withStroke(linewidth=4.0, foreground="white")]
    axes.plot([x - length * per_mm, x], [y, y], color="0.1", linewidth=2.2, solid_capstyle="butt", path_effects=around)
    axes.text(
        x - 0.5 * length * per_mm, y - 8.0, f"{length:g} mm", ha="center", va="bottom", size=9, path_effects=around
    )


def draw_axes(axes: "Axes", names: Sequence[str], camera: Camera) -> None:
    """The world's axes as the camera sees them."""
    view = np.stack([np.cross(camera.up, camera.towards_eye), camera.up])
    axes.set(xlim=(-1.5, 1.5), ylim=(-0.75, 1.35), aspect="equal")
    axes.set_axis_off()
    arrow = {"arrowstyle": "-|>", "color": "0.2", "shrinkA": 0, "shrinkB": 0}
    for along, name in zip(0.8 * view.T, names, strict=True):
        if np.hypot(*along) < 0.2:
            continue
        axes.annotate("", along, (0.0, 0.0), arrowprops=arrow)
        x, y = along * (1.0 + 0.12 / np.hypot(*along))
        axes.text(x, y, name, ha="left" if along[0] > -0.05 else "right", va="center", size=9)
