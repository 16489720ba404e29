"""The bone before and after a run, in one picture."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tissue.builders.voxels import reach
from tissue.figures.figure import DPI, figure, save
from tissue.figures.rendering import Camera, Coloured, render
from tissue.figures.style import BONE, axis_names, depth_colours, depth_limit, layer_colours
from tissue.simulation.bone_surface import bone_surface, cut_out, smooth_normals, with_depth, with_layers
from tissue.simulation.depth_map import HALF, DepthMap
from tissue.simulation.run import Run

if TYPE_CHECKING:
    import pyvista

__all__ = ["draw_before_after"]

PANEL_PX = 780
TILT_DEG = (36.0, 12.0)
"""How far the eye turns down and to the side from the tool's axis."""
CUT_OUT = (0.82, 0.82, 0.85)
"""Colour of faces where the simulated region ends and the bone goes on."""


def draw_before_after(run: Run, depth: DepthMap, path: Path) -> str | None:
    """Draw the bone by layer before and by removed depth after the run, both seen by the same camera.

    Returns
    -------
    None, or why it could not be drawn.
    """
    volume, limit = run.volume, depth_limit(depth)
    if min(int(volume.fraction.max()), int(run.remaining.max())) < HALF:
        return "no bone is left to show"
    cameras: list[Camera] = []

    def make() -> tuple[list[Coloured], Camera]:
        """Both surfaces, and where they are seen from."""
        whole = bone_surface(volume, volume.fraction)
        camera = _camera(whole, depth)
        before = with_layers(_seen(whole, camera), volume)
        after = _seen(bone_surface(volume, run.remaining), camera)
        with_depth(after, volume, run.remaining, depth_mm=depth.depth_mm, axis=depth.axis)
        cameras.append(camera)
        painted = np.array(list(layer_colours(volume.layer_names).values()))[before.cell_data["layer"]]
        carved = _depth_paint(after.point_data["removed_depth_mm"], limit)[after.regular_faces].mean(axis=1)
        carved[cut_out(after, volume, _reach(run))] = CUT_OUT
        return [_coloured(before, painted), _coloured(after, carved)], camera

    pictures = render(make)
    if isinstance(pictures, str):
        return pictures
    present = np.bincount(volume.layer[volume.fraction >= HALF], minlength=len(volume.layer_names)) > 0
    layers = [name for name, there in zip(volume.layer_names, present, strict=True) if there]
    _compose(run, pictures, cameras[0], layers, limit, path)
    return None


def _reach(run: Run) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The box that was simulated [m]; the bone goes on beyond it."""
    return reach(run.cutter, run.parts.motion, run.scene.voxels.margin_mm * 1e-3)


def _depth_paint(depth_mm: NDArray[np.float32], limit: float) -> NDArray[np.float64]:
    """Colours of points by removed depth, bone where nothing was removed; they blend over the first few hundredths."""
    share = np.clip((depth_mm / limit - 0.01) / 0.03, 0.0, 1.0)[:, None]
    return share * depth_colours()(depth_mm / limit)[:, :3] + (1.0 - share) * np.array(BONE)


def _seen(surface: "pyvista.PolyData", camera: Camera) -> "pyvista.PolyData":
    """The surface without the triangles that face away from the camera."""
    import pyvista

    normals, triangles = surface.point_data["Normals"], surface.regular_faces
    facing = np.asarray(normals) @ np.array(camera.towards_eye, dtype=np.float32) > -0.2
    part = pyvista.PolyData.from_regular_faces(surface.points, triangles[facing[triangles].any(axis=1)])
    part.point_data["Normals"] = normals
    return part


def _coloured(surface: "pyvista.PolyData", colours: NDArray[np.float64]) -> Coloured:
    return Coloured(
        points_mm=np.asarray(surface.points, dtype=np.float32),
        normals=smooth_normals(surface),
        triangles=np.asarray(surface.regular_faces),
        colours=np.rint(255.0 * colours).astype(np.uint8),
    )


def _camera(surface: "pyvista.PolyData", depth: DepthMap) -> Camera:
    """A camera that sees the whole surface from the tool's side, turned down and aside."""
    out, v = np.eye(3)[depth.axis] * depth.outward, np.eye(3)[depth.across[1]]
    u = np.cross(v, out)
    down, aside = np.radians(TILT_DEG)
    towards = np.cos(down) * (np.cos(aside) * out + np.sin(aside) * u) - np.sin(down) * v
    up = v - (v @ towards) * towards
    up /= np.linalg.norm(up)
    right = np.cross(up, towards)
    # Points of the surface itself, not of its box, so that the bone fills the picture.
    seen = np.asarray(surface.points)[:: max(surface.n_points // 20000, 1)] @ np.column_stack([right, up, towards])
    first, last = seen.min(axis=0), seen.max(axis=0)
    middle = 0.5 * (first + last)
    width, height = 1.06 * (last - first)[:2]
    tall = int(np.clip(PANEL_PX * height / width, 0.45 * PANEL_PX, 1.15 * PANEL_PX)) // 2 * 2
    height = max(height, width * tall / PANEL_PX)
    centre = middle[0] * right + middle[1] * up + middle[2] * towards
    return Camera(tuple(towards), tuple(up), tuple(centre), height_mm=float(height), size=(PANEL_PX, tall))


def _compose(
    run: Run, pictures: list[NDArray[np.uint8]], camera: Camera, layers: list[str], limit: float, path: Path
) -> None:
    """Put the two pictures side by side with legend, colour bar, scale bar and axes."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.patches import Patch

    wide, tall = camera.size
    gap, head, foot = 40, 64, 170
    size = 2 * wide + gap, tall + head + foot
    chart = figure(size[0] / DPI, size[1] / DPI)
    for index, (picture, title) in enumerate(zip(pictures, ("before", "after"), strict=True)):
        left = index * (wide + gap) / size[0]
        axes = chart.add_axes((left, foot / size[1], wide / size[0], tall / size[1]))
        axes.imshow(picture, interpolation="nearest")
        axes.set_axis_off()
        chart.text(left + 0.5 * wide / size[0], 1.0 - 0.5 * head / size[1], title, ha="center", va="center", size=11)
        _draw_scale(axes, camera)
    colours = layer_colours(run.volume.layer_names)
    patch: dict[str, Any] = {"edgecolor": "0.3", "linewidth": 0.5}
    legend: dict[str, Any] = {"loc": "center", "frameon": False, "handlelength": 1.2, "labelspacing": 0.3}
    chart.legend(
        handles=[Patch(facecolor=colours[name], label=name, **patch) for name in layers],
        bbox_to_anchor=(0.2 * wide / size[0], 0.5 * foot / size[1]),
        **legend,
    )
    chart.legend(
        handles=[
            Patch(facecolor=BONE, label="not cut", **patch),
            Patch(facecolor=CUT_OUT, label="edge of the\nsimulated region", **patch),
        ],
        bbox_to_anchor=((wide + gap + 0.2 * wide) / size[0], 0.5 * foot / size[1]),
        **legend,
    )
    _draw_triad(chart.add_axes((0.28, 0.0, 0.18, foot / size[1])), run, camera)
    bar = chart.add_axes(
        ((wide + gap + 0.45 * wide) / size[0], 0.58 * foot / size[1], 0.48 * wide / size[0], 0.14 * foot / size[1])
    )
    mapped = ScalarMappable(Normalize(0.0, limit), depth_colours())
    chart.colorbar(mapped, cax=bar, orientation="horizontal").set_label("removed depth / mm")
    save(chart, path)


def _draw_scale(axes: Any, camera: Camera) -> None:
    """A bar of a round length; the projection is parallel, so it holds across the picture."""
    per_mm = camera.size[1] / camera.height_mm
    longest = 0.25 * camera.size[0] / per_mm
    length = max(step for step in (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0) if step <= max(longest, 0.5))
    x, y = camera.size[0] - 20.0, camera.size[1] - 16.0
    axes.plot([x - length * per_mm, x], [y, y], color="0.1", linewidth=2.2, solid_capstyle="butt")
    axes.text(x - 0.5 * length * per_mm, y - 8.0, f"{length:g} mm", ha="center", va="bottom", size=9)


def _draw_triad(axes: Any, run: Run, camera: Camera) -> None:
    """The world's axes as the camera sees them."""
    towards, up = np.array(camera.towards_eye), np.array(camera.up)
    view = np.stack([np.cross(up, towards), up])
    axes.set(xlim=(-1.5, 1.5), ylim=(-0.75, 1.35), aspect="equal")
    axes.set_axis_off()
    for axis, name in enumerate(axis_names(run)):
        along = 0.8 * view[:, axis]
        if np.hypot(*along) < 0.1:
            continue
        arrow = {"arrowstyle": "-|>", "color": "0.2", "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", along, (0.0, 0.0), arrowprops=arrow)
        at = along * (1.0 + 0.12 / np.hypot(*along))
        axes.text(*at, name, ha="left" if along[0] > -0.05 else "right", va="center", size=8)
