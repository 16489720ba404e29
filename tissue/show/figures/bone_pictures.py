"""Figures of carved bone: before and after in 3D, and the map of removed depth."""

from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from meshes.base.arrays import Array, Bytes, Flags, Singles
from meshes.voxels.volume import VoxelVolume
from tissue.scene.tool import Tool
from tissue.show.figures.figure import (
    BONE,
    DEPTH_COLOURS,
    EDGE,
    axis_names,
    depth_limit,
    draw_arrow,
    draw_outline,
    halo,
    layer_colours,
    panelled,
    save,
    styled,
)
from tissue.show.figures.rendering import Camera, Shaded, draw_axes, draw_shaded, paint
from tissue.show.figures.section import plane_of
from tissue.show.figures.tool_mesh import pose, spin_arc_mm, tool_turns
from tissue.simulation.bone_surface import (
    HALF,
    DepthMap,
    bone_surface,
    cut_faces,
    cut_out,
    smooth_normals,
    with_depth,
    with_layers,
)
from tissue.simulation.builders.parts import reach
from tissue.simulation.run import Run

if TYPE_CHECKING:
    import pyvista
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

__all__ = ["draw_before_after", "draw_removed_depth"]


HEIGHTS_PX = 64, 170
"""Heights above and below the renderings [pixels]."""
TILT_DEG = (36.0, 12.0)
OPENED_DEG = (58.0, 12.0)
"""Angles of the view from the tool's axis (downwards, sideways), for a bone that is cut open.

`TILT_DEG` has the angles for a whole bone.
"""
DEEP = 0.5
"""Ratio of a cut's depth to its shorter side above which the bone is drawn opened.

The bottom of such a cut is not visible from the side of the tool.
"""
CUT_OUT = (0.82, 0.82, 0.85)
"""Colour of faces at the end of the simulated region; the bone continues beyond these faces."""
MOST_POINTS = 20_000
"""Largest number of surface points used to place the camera; it suffices to find the extent."""
WIDEST_ARC = 0.4
"""Largest width of the arrow around the tool's axis, relative to the height of the picture."""


@dataclass(frozen=True)
class _View:
    """Bone before and after a run, cut open if necessary, and the view of the bone.

    Attributes
    ----------
    volume, remaining
        Bone before and after the run. The part in front of the plane is left out.
    depth
        Depth map, which contains the side from which the tool came.
    plane
        World axis perpendicular to the plane of the opened bone, and the coordinate of the plane
        [mm]. None if the bone is not opened.
    """

    volume: VoxelVolume
    remaining: Bytes
    depth: DepthMap
    plane: tuple[int, float] | None

    @classmethod
    def of(cls, run: Run, depth: DepthMap) -> "_View":
        """Return the view of the whole bone, or of the opened bone.

        For a deep and narrow cut, only the half of the bone behind the deepest point is visible.
        """
        volume = run.volume
        remaining = run.remaining
        cut = np.argwhere(depth.depth_mm > 0.0)
        spacing = 1e3 * volume.spacing_m
        if not len(cut) or depth.depth_mm.max() < DEEP * spacing * float(
            (np.ptp(cut, axis=0) + 1).min()
        ):
            return cls(volume, remaining, depth, None)
        (*_, normal), place = plane_of(run, len(run.trace.rows) - 1)
        first = int((place * 1e-3 - volume.origin_m[normal]) / volume.spacing_m)
        count = volume.shape[normal]
        behind = np.arange(count) >= np.clip(first, 0, count - 1)
        keep = behind.reshape([-1 if axis == normal else 1 for axis in range(3)])
        half = replace(volume, fraction=np.where(keep, volume.fraction, np.uint8(0)))
        return cls(half, np.where(keep, remaining, np.uint8(0)), depth, (normal, place))

    def camera(self, surface: "pyvista.PolyData") -> Camera:
        """Return a tilted camera that sees the whole surface from the tool's side.

        For an opened bone, the camera is in front of the plane.
        """
        depth = self.depth
        out = np.eye(3)[depth.axis] * depth.outward
        v = np.eye(3)[depth.across[1] if self.plane is None else self.plane[0]]
        down, aside = np.radians(TILT_DEG if self.plane is None else OPENED_DEG)
        towards = (
            np.cos(down) * (np.cos(aside) * out + np.sin(aside) * np.cross(v, out))
            - np.sin(down) * v
        )
        # Points of the surface are used instead of its bounding box, so the bone fills the picture.
        return Camera.seeing(
            np.asarray(surface.points)[:: max(surface.n_points // MOST_POINTS, 1)], towards, v
        )

    def opened(self, surface: "pyvista.PolyData") -> Flags:
        """Return a mask of the triangles that lie in the plane at which the bone is cut open."""
        if self.plane is None:
            return np.zeros(surface.n_cells, dtype=bool)
        axis, place = self.plane
        points = np.asarray(surface.points)
        triangles = surface.regular_faces
        near = np.abs(points[:, axis] - place) < 1e3 * self.volume.spacing_m
        # The bevel along the edge of the plane belongs to the plane. Smoothed normals differ there,
        # so the normals of the triangles decide.
        corners = points[triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        flat = 2.0 * normals[:, axis] ** 2 > 0.99 * (normals**2).sum(axis=1)
        return np.asarray(near[triangles].all(axis=1) & flat)


def draw_before_after(run: Run, depth: DepthMap, path: Path) -> str | None:
    """Draw the bone before the run, coloured by layer, and after it, coloured by removed depth.

    Both pictures have the same camera.

    Returns
    -------
    None, or the reason why the picture could not be drawn.
    """
    limit = depth_limit(depth)
    view = _View.of(run, depth)
    volume = view.volume
    remaining = view.remaining
    # a surface is drawn where voxels are half full
    if min(int(volume.fraction.max()), int(remaining.max())) < HALF:
        return "no bone is left to show"

    def make() -> "list[tuple[pyvista.PolyData, Camera]]":
        """Return the bone before and after the run, seen by the same camera."""
        whole = bone_surface(volume, volume.fraction)
        camera = view.camera(whole)
        before = with_layers(_seen(whole, camera), volume)
        after = with_layers(_seen(bone_surface(volume, remaining), camera), volume)
        with_depth(after, volume, remaining, depth_mm=depth.depth_mm, axis=depth.axis)
        colours = np.array(list(layer_colours(volume.layer_names).values()))
        carved = _depth_paint(after.point_data["removed_depth_mm"], limit)[
            after.regular_faces
        ].mean(axis=1)
        carved[cut_out(after, volume, _simulated_m(run))] = CUT_OUT
        opened = view.opened(after)
        carved[opened] = colours[after.cell_data["layer"][opened]]
        for surface in (before, after):
            surface.point_data["Normals"] = smooth_normals(surface)
        return [
            (paint(before, colours[before.cell_data["layer"]]), camera),
            (paint(after, carved), camera),
        ]

    def annotate(shaded: Shaded) -> None:
        _annotate(shaded, run, view, limit)

    opened = (
        ""
        if view.plane is None
        else f", cut open at {'xyz'[view.plane[0]]} = {view.plane[1]:.2f} mm"
    )
    names = [f"{when}{opened}" for when in ("before", "after")]
    return draw_shaded(make, path, annotate, margins_px=HEIGHTS_PX, names=names)


def _simulated_m(run: Run) -> tuple[Array, Array]:
    """Return the corners of the simulated region, beyond which the bone continues [m]."""
    return reach(run.cutter, run.parts.motion, run.scene.voxels.margin_mm * 1e-3)


def _depth_paint(depth_mm: Singles, limit: float) -> Array:
    """Return the colours of points as a function of removed depth.

    At small depths, the colours blend into the colour of bone.
    """
    from matplotlib import colormaps

    # from bone at 1 % of the depth scale to the full colour at 4 %
    share = np.clip((depth_mm / limit - 0.01) / 0.03, 0.0, 1.0)[:, None]
    return share * colormaps[DEPTH_COLOURS](depth_mm / limit)[:, :3] + (1.0 - share) * np.array(
        BONE
    )


def _seen(surface: "pyvista.PolyData", camera: Camera) -> "pyvista.PolyData":
    """Return the surface without the triangles that face away from the camera."""
    import pyvista

    normals = surface.point_data["Normals"]
    triangles = surface.regular_faces
    # smoothed normals differ from those of the triangles, so some triangles that face slightly away
    # are kept
    facing = np.asarray(normals) @ np.array(camera.towards_eye, dtype=np.float32) > -0.2
    part = pyvista.PolyData.from_regular_faces(
        surface.points, triangles[facing[triangles].any(axis=1)]
    )
    part.point_data["Normals"] = normals
    return part


def _annotate(shaded: Shaded, run: Run, view: _View, limit: float) -> None:
    """Add legends, colour bar, axes and the sense of rotation of the tool."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.patches import Patch

    volume = view.volume
    chart = shaded.chart
    colours = layer_colours(volume.layer_names)
    present = np.unique(volume.layer[volume.fraction >= HALF])
    kinds = {"not cut": BONE}
    towards = shaded.cameras[0].towards_eye
    if any(side * towards[axis] > 0.0 for axis, side in cut_faces(volume, _simulated_m(run))):
        kinds["edge of the\nsimulated region"] = CUT_OUT
    named = (
        {volume.layer_names[index]: colours[volume.layer_names[index]] for index in present},
        kinds,
    )
    for axes, legend in zip(shaded.panels, named, strict=True):
        # `foot` is the height below the panel, which the legends and the colour bar share
        left, foot, wide, _ = axes.get_position().bounds
        chart.legend(
            handles=[
                Patch(facecolor=colour, label=name, **EDGE) for name, colour in legend.items()
            ],
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


def _draw_spin(axes: "Axes", run: Run, camera: Camera) -> None:
    """Draw the sense of the tool's rotation at its first contact.

    The arc is as wide as the tool, if there is enough space.
    """
    tool = run.scene.tool
    assert isinstance(tool, Tool)
    row = int((run.trace["contact_mm2"] > 0.0).argmax())
    matrix = pose(run.trace.vectors("tool", "mm")[row], tool_turns(run.trace)[row])
    share = min(1.0, WIDEST_ARC * camera.height_mm / tool.diameter_mm)
    axes.set_autoscale_on(False)
    arc = camera.pixels(share * spin_arc_mm(tool) @ matrix[:3, :3].T + matrix[:3, 3])
    # the last three points are left to the head of the arrow
    axes.plot(*arc[:-3].T, color="0.1", linewidth=1.6, path_effects=halo())
    draw_arrow(axes, arc[-4], arc[-1], "0.1")
    x, y = arc[np.argmin(arc[:, 1])]
    # 8 pixels above the arc
    axes.text(x, y - 8.0, "spin", ha="center", va="bottom", size=9, path_effects=halo())


EXPOSED: tuple[Any, ...] = ("--", ":", "-.")
"""Line styles around the layers that a run exposed."""
SMALL = 0.5
AROUND = 0.4
"""Margin around a small cut in an enlarged map, relative to the longer side of the cut.

A cut is small if its extent along both axes is at most `SMALL` times the extent of the region.


The map of a larger cut shows the whole region.
"""


def shown_mm(depth: DepthMap) -> tuple[float, float, float, float]:
    """Return the drawn extent of the map of removed depth, (u0, u1, v0, v1) [mm].

    u and v are the two axes of the map. The extent is the whole region, or the surroundings of a
    small cut.
    """
    u0, u1, v0, v1 = depth.extent_mm
    cut = np.argwhere(depth.depth_mm > 0.0)
    if not len(cut):
        return u0, u1, v0, v1
    start = np.array([u0, v0])
    size = np.array([u1 - u0, v1 - v0])
    edge = size / depth.depth_mm.shape
    low = cut.min(axis=0) * edge
    high = (cut.max(axis=0) + 1) * edge
    if ((high - low) > SMALL * size).any():
        return u0, u1, v0, v1
    around = AROUND * float((high - low).max())
    (u0, v0), (u1, v1) = start + np.clip([low - around, high + around], 0.0, size)
    return float(u0), float(u1), float(v0), float(v1)


def _within(depth: DepthMap, shown: tuple[float, float, float, float]) -> tuple[slice, slice]:
    """Return the rows and columns of the map that lie in an extent along both axes [mm]."""
    u0, u1, v0, v1 = depth.extent_mm
    start = np.array([u0, v0])
    edge = np.array([u1 - u0, v1 - v0]) / depth.depth_mm.shape
    low = np.rint((np.array(shown[::2]) - start) / edge).astype(int)
    high = np.rint((np.array(shown[1::2]) - start) / edge).astype(int)
    return slice(low[0], high[0]), slice(low[1], high[1])


@styled
def draw_removed_depth(run: Run, depth: DepthMap, path: Path) -> None:
    """Draw a map of the removed depth over the face of the bone that the tool enters."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    u0, u1, v0, v1 = shown_mm(depth)
    # the map is at most 6 inches wide and 6.4 tall; the rest of the figure holds colour bar and
    # legend
    per_mm = min(6.0 / (u1 - u0), 6.4 / (v1 - v0))
    spacing = run.volume.spacing_m * 1e3
    # a hundredth of a voxel: smaller depths are steps of a fraction's byte
    least = 0.01 * spacing
    cut = depth.depth_mm[depth.depth_mm >= least]
    summary = "nothing removed"
    if cut.size:
        summary = (
            f"removed depth, peak {cut.max():.2f} mm, median {np.median(cut):.2f} mm over "
            f"{cut.size * spacing**2:.3g} mm²"
        )
    chart, (axes,) = panelled(
        f"{run.scene.name}: {summary}", (8.0, per_mm * (v1 - v0) + 1.35), layout="compressed"
    )
    placed = {"origin": "lower", "extent": depth.extent_mm, "interpolation": "nearest"}
    ground = np.where(depth.bone[..., None], BONE, 1.0)
    axes.imshow(ground.swapaxes(0, 1), **placed)
    image = axes.imshow(
        np.ma.masked_less(depth.depth_mm, least).T,
        cmap=DEPTH_COLOURS,
        vmin=0.0,
        vmax=depth_limit(depth),
        **placed,
    )
    chart.colorbar(image, ax=axes, label="removed depth / mm")
    draw_outline(axes, depth.bone, depth.extent_mm, color="0.15", linewidth=1.0)
    # white under black keeps the outline of a layer visible on dark depths
    handles: list[Artist] = [
        Patch(facecolor=BONE, label="not cut", **EDGE),
    ]
    if not depth.bone[_within(depth, (u0, u1, v0, v1))].all():
        label = "bone in the simulated region"
        handles.append(Line2D([], [], color="0.15", linewidth=1.0, label=label))
    for (name, mask), dashes in zip(depth.exposed.items(), cycle(EXPOSED), strict=False):
        draw_outline(axes, mask, depth.extent_mm, color="white", linewidth=2.6)
        # half as wide as the white line below
        look = {"color": "black", "linewidth": 1.3, "linestyle": dashes}
        draw_outline(axes, mask, depth.extent_mm, **look)
        handles.append(Line2D([], [], label=f"{name} laid bare", **look))
    axes.set(xlim=(u0, u1), ylim=(v0, v1), aspect="equal")
    x, y = (f"{axis_names(run)[axis]} / mm" for axis in depth.across)
    axes.set(xlabel=x, ylabel=y)
    chart.legend(handles=handles, loc="outside lower center", ncols=4)
    save(chart, path)
