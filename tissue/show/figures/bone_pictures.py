"""Figure of carved bone, before and after a run."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.arrays import Bytes, Flags
from meshes.voxels.volume import VoxelVolume
from tissue.scene.tool import Tool
from tissue.show.figures.figure import (
    BONE,
    DEPTH_COLOURS,
    EDGE,
    axis_names,
    depth_limit,
    draw_arrow,
    halo,
    layer_colours,
)
from tissue.show.figures.rendering import Camera, Shaded, draw_axes, draw_shaded, paint
from tissue.show.figures.section import plane_of
from tissue.show.figures.tool_mesh import pose, spin_arc_mm
from tissue.simulation.bone_surface import (
    HALF,
    DepthMap,
    bone_surface,
    cut_out,
    depth_map,
    smooth_normals,
    triangle_means,
    with_depth,
    with_layers,
)
from tissue.simulation.builders.voxels import requested_region
from tissue.simulation.run import Run

if TYPE_CHECKING:
    import pyvista
    from matplotlib.axes import Axes

Plane = tuple[int, float]
"""World axis perpendicular to a plane, and the coordinate of the plane [mm]."""
HEIGHTS_PX = 64, 170
"""Heights of the margins above and below the renderings [pixels]."""
TILT_DEG = (36.0, 12.0)
OPENED_DEG = (58.0, 12.0)
"""Angles [degrees] between camera and tool axis, downwards and sideways, for a bone drawn cut open.

`TILT_DEG` has the angles for a bone that is drawn whole.
"""
DEEP = 0.5
"""Ratio of a cut's depth to its smaller width above which the bone is drawn cut open.

The bottom of a deeper cut is not visible from the side of the tool.
"""
UNCUT = 0.02
"""Removed depth, relative to the deepest cut, below which bone counts as uncut."""
CUT_OUT = (0.82, 0.82, 0.85)
"""Colour of the faces at which the simulated region ends although the bone continues."""
WIDEST_ARC = 0.4
"""Largest width of the arrow for the tool's rotation, relative to the picture's height."""


def draw_before_after(run: Run, path: Path) -> str | None:
    """Draw the bone before the run, coloured by layer, and after it, coloured by removed depth.

    Both pictures have the same camera. If a cut is deep and narrow, the bone is drawn cut open at
    the deepest point.

    Returns
    -------
    None, or the reason why the picture could not be drawn.
    """
    depth = depth_map(run)
    volume, remaining, plane = _drawn_bone(run, depth)
    # a surface is drawn where voxels are half full
    if min(int(volume.fraction.max()), int(remaining.max())) < HALF:
        return "no bone is left to show"
    limit = depth_limit(depth)
    layers = layer_colours(volume.layer_names)
    ends = np.array(list(layers.values()))
    before = with_layers(bone_surface(volume, volume.fraction), volume)
    after = with_layers(bone_surface(volume, remaining), volume)
    is_end = cut_out(after, volume, requested_region(run.scene, run.cutter, run.parts.motion))

    def make() -> "list[tuple[pyvista.PolyData, Camera]]":
        """Return the bone before and after the run, seen by the same camera."""
        from matplotlib import colormaps

        with_depth(after, volume, remaining, depth_mm=depth.depth_mm, axis=depth.axis)
        removed_mm = triangle_means(after.point_data["removed_depth_mm"], after.regular_faces)
        carved = colormaps[DEPTH_COLOURS](removed_mm / limit)[:, :3]
        carved[removed_mm < UNCUT * limit] = BONE
        carved[is_end] = CUT_OUT
        in_plane = _in_plane(after, plane, 1e3 * volume.spacing_m)
        carved[in_plane] = ends[after.cell_data["layer"][in_plane]]
        for surface in (before, after):
            surface.point_data["Normals"] = smooth_normals(surface)
        camera = _camera(before, depth, plane)
        return [
            (paint(before, ends[before.cell_data["layer"]]), camera),
            (paint(after, carved), camera),
        ]

    def annotate(shaded: Shaded) -> None:
        """Add legends, colour bar, axes and the sense of rotation of the tool."""
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import Normalize
        from matplotlib.patches import Patch

        present = np.unique(volume.layer[volume.fraction >= HALF])
        kinds = {"not cut": BONE}
        facing = triangle_means(after.point_data["Normals"], after.regular_faces)
        if (facing[is_end] @ shaded.cameras[0].towards_eye > 0.0).any():
            kinds["edge of the\nsimulated region"] = CUT_OUT
        named = {volume.layer_names[index]: tuple(ends[index]) for index in present}, kinds
        chart = shaded.chart
        for axes, legend in zip(shaded.panels, named, strict=True):
            # `foot` is the height below the panel, which the legends and the colour bar share
            left, foot, wide, _ = axes.get_position().bounds
            chart.legend(
                handles=[Patch(facecolor=rgb, label=name, **EDGE) for name, rgb in legend.items()],
                loc="center",
                bbox_to_anchor=(left + 0.2 * wide, 0.5 * foot),
                frameon=False,
            )
        camera = shaded.cameras[0]
        _draw_spin(shaded.panels[0], run, camera)
        # the triad between the two legends; the colour bar in the upper half under the right of the
        # second panel, so that its label fits below
        draw_axes(chart.add_axes((0.28, 0.0, 0.18, foot)), axis_names(run), camera)
        bar = chart.add_axes((left + 0.45 * wide, 0.58 * foot, 0.48 * wide, 0.14 * foot))
        mapped = ScalarMappable(Normalize(0.0, limit), DEPTH_COLOURS)
        chart.colorbar(mapped, cax=bar, orientation="horizontal").set_label("removed depth / mm")

    opened = "" if plane is None else f", cut open at {'xyz'[plane[0]]} = {plane[1]:.2f} mm"
    cut_mm2 = 1e6 * volume.spacing_m**2 * np.count_nonzero(depth.depth_mm >= UNCUT * limit)
    summary = "not cut"
    if depth.depth_mm.any():
        summary = f"{limit:.2f} mm deep, cut area {cut_mm2:.3g} mm²"
    names = [f"before{opened}", f"after: {summary}"]
    return draw_shaded(make, path, annotate, margins_px=HEIGHTS_PX, names=names)


def _drawn_bone(run: Run, depth: DepthMap) -> tuple[VoxelVolume, Bytes, Plane | None]:
    """Return the bone before and after a run, and the plane at which it is drawn cut open.

    The plane is None if the bone is drawn whole.
    """
    volume = run.volume
    cut = np.argwhere(depth.depth_mm > 0.0)
    narrow_mm = 1e3 * volume.spacing_m * (np.ptp(cut, axis=0) + 1).min() if len(cut) else np.inf
    if depth.depth_mm.max() < DEEP * narrow_mm:
        return volume, run.remaining, None
    (*_, normal), place = plane_of(run, len(run.trace.rows) - 1)
    index = int((1e-3 * place - volume.origin_m[normal]) / volume.spacing_m)
    keep = np.zeros(volume.shape, dtype=np.uint8)
    np.moveaxis(keep, normal, 0)[min(max(index, 0), volume.shape[normal] - 1) :] = 1
    half = replace(volume, fraction=volume.fraction * keep)
    return half, run.remaining * keep, (normal, place)


def _camera(surface: "pyvista.PolyData", depth: DepthMap, plane: Plane | None) -> Camera:
    """Return a tilted camera that sees the whole surface from the tool's side.

    If the bone is cut open, the camera is in front of the plane.
    """
    out = depth.outward * np.eye(3)[depth.axis]
    up = np.eye(3)[depth.across[1] if plane is None else plane[0]]
    down, aside = np.radians(TILT_DEG if plane is None else OPENED_DEG)
    turned = np.cos(aside) * out + np.sin(aside) * np.cross(up, out)
    return Camera.seeing(surface.points, np.cos(down) * turned - np.sin(down) * up, up)


def _in_plane(surface: "pyvista.PolyData", plane: Plane | None, spacing_mm: float) -> Flags:
    """Return a mask of the triangles in the plane at which the bone is cut open."""
    if plane is None:
        return np.zeros(surface.n_cells, dtype=bool)
    axis, place = plane
    corners = np.asarray(surface.points)[surface.regular_faces]
    near = (np.abs(corners[..., axis] - place) < spacing_mm).all(axis=1)
    # The bevel along the edge of the plane belongs to the plane. Smoothed normals differ there, so
    # the normals of the triangles decide.
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat = 2.0 * normals[:, axis] ** 2 > 0.99 * (normals**2).sum(axis=1)
    return np.asarray(near & flat)


def _draw_spin(axes: "Axes", run: Run, camera: Camera) -> None:
    """Draw the sense of the tool's rotation at its first contact.

    The rotation is drawn as an arrow along an arc, which is as wide as the tool if there is enough
    space.
    """
    tool = run.scene.tool
    assert isinstance(tool, Tool)
    row = int((run.trace["contact_mm2"] > 0.0).argmax())
    matrix = pose(run.trace.vectors("tool", "mm")[row], run.trace.quaternions()[row])
    share = min(1.0, WIDEST_ARC * camera.height_mm / tool.diameter_mm)
    axes.set_autoscale_on(False)
    arc = camera.pixels(share * spin_arc_mm(tool) @ matrix[:3, :3].T + matrix[:3, 3])
    # the last three points are left to the head of the arrow
    axes.plot(*arc[:-3].T, color="0.1", linewidth=1.6, path_effects=halo())
    draw_arrow(axes, arc[-4], arc[-1], "0.1")
    x, y = arc[np.argmin(arc[:, 1])]
    # 8 pixels above the arc
    axes.text(x, y - 8.0, "spin", ha="center", va="bottom", size=9, path_effects=halo())
