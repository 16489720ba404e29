"""Structures to keep clear of in a section: their outline, and the least distance that the tool had from each."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue.models.keep_clear import Distance
from tissue.simulation.run import Run

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

__all__ = ["Window", "draw_kept_clear", "kept_window", "nearest_places"]

Window = tuple[float, float, float, float]
"""Lowest and highest coordinate along the two axes of a section, (u0, u1, v0, v1) [mm]."""
COLOURS = ("#D55E00", "#0072B2", "#009E73", "#000000")
"""After Okabe and Ito (2008)."""
AROUND_MM = 3.0
"""What is shown of a structure beyond its nearest point."""
ACROSS = 200
"""Points along each side of the section at which the distance is asked for."""
STEP_M = 1e-5
"""Of the differences that make the direction of a distance."""


@dataclass(frozen=True, eq=False)
class Nearest:
    """Where the tool came nearest to a structure.

    Attributes
    ----------
    name, distance
        The structure.
    tool_mm, structure_mm
        Points of the tool's body and of the structure's surface [mm], shape (3,).
    least_mm
        Their distance, negative inside the structure [mm].
    """

    name: str
    distance: Distance
    tool_mm: NDArray[np.float64]
    structure_mm: NDArray[np.float64]
    least_mm: float


def nearest_places(run: Run) -> list[Nearest]:
    """Where a run's tool came nearest to each structure that it had to keep clear of; none without any."""
    from scipy.spatial.transform import Rotation

    clear, trace, found = run.parts.keep_clear, run.trace, []
    for name, distance in () if clear is None else clear.distances.items():
        row = int(np.argmin(trace[f"distance_{name}_mm"]))
        turn = Rotation.from_quat([trace[f"tool_q{c}"][row] for c in "xyzw"])
        body_m = 1e-3 * trace.vectors("tool", "mm")[row] + turn.apply(np.asarray(clear.points_m) if clear else [])
        point = body_m[int(np.argmin(distance(body_m)))]
        steps = np.vstack([np.zeros(3), STEP_M * np.eye(3), -STEP_M * np.eye(3)])
        values = np.asarray(distance(point + steps), dtype=np.float64)
        slope = (values[1:4] - values[4:]) / (2.0 * STEP_M)
        on_surface = point - values[0] * slope / max(float(np.linalg.norm(slope)), 1e-9)
        least = float(trace[f"distance_{name}_mm"][row])
        found.append(Nearest(name, distance, 1e3 * point, 1e3 * on_surface, least))
    return found


def kept_window(places: Sequence[Nearest], window: Window, tissue: NDArray[np.bool_], across: int, axis: int) -> Window:
    """Sides around the tissue of a section, shape (nu, nv), and the nearest of each structure; all without any."""
    if not places or not tissue.any():
        return window
    u0, u1, v0, v1 = window
    size = np.array([u1 - u0, v1 - v0]) / tissue.shape
    (a, b), (c, d) = ((each.min() * s, (each.max() + 1) * s) for each, s in zip(np.nonzero(tissue), size, strict=True))
    u0, u1 = max(u0, u0 + a - AROUND_MM), min(u1, u0 + b + AROUND_MM)
    v0, v1 = max(v0, v0 + c - AROUND_MM), min(v1, v0 + d + AROUND_MM)
    for place in places:
        u, v = place.structure_mm[[across, axis]].tolist()
        u0, u1 = min(u0, u - AROUND_MM), max(u1, u + AROUND_MM)
        v0, v1 = min(v0, v - AROUND_MM), max(v1, v + AROUND_MM)
    return u0, u1, v0, v1


def draw_kept_clear(
    axes: "Axes", places: Sequence[Nearest], window: Window, across: int, axis: int, place_mm: float
) -> "list[Artist]":
    """Draw structures in a section at a place along its normal; returns entries of a legend with the least distances.

    A line between two dots joins the points of tool and structure that came nearest, seen along the normal.
    """
    from matplotlib.lines import Line2D

    u, v = (np.linspace(window[k], window[k + 1], ACROSS) for k in (0, 2))
    points = np.full((ACROSS, ACROSS, 3), place_mm)
    points[..., across], points[..., axis] = u[None, :], v[:, None]
    handles: list[Artist] = []
    for number, place in enumerate(places):
        colour = COLOURS[number % len(COLOURS)]
        depth = np.asarray(place.distance(1e-3 * points.reshape(-1, 3))).reshape(ACROSS, ACROSS)
        if depth.min() < 0.0 < depth.max():
            axes.contourf(u, v, depth, levels=[float(depth.min()), 0.0], colors=[colour], alpha=0.15)
            axes.contour(u, v, depth, levels=[0.0], colors=[colour], linewidths=[1.6])
        ends = np.array([place.tool_mm, place.structure_mm])[:, [across, axis]]
        axes.plot(*ends.T, "o-", color=colour, markersize=3.5, linewidth=1.0)
        how = f"{place.least_mm:.2f} mm away" if place.least_mm >= 0.0 else f"{-place.least_mm:.2f} mm inside"
        label = f"{place.name}; the tool at its nearest, {how}"
        handles.append(Line2D([], [], color=colour, linewidth=1.6, marker="o", markersize=3.5, label=label))
    axes.set(xlim=window[:2], ylim=window[2:])
    return handles
