"""Figures of a CT import: slices, histogram, bone, organ and the depth of a path."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.images.frame import Image, part_of
from meshes.paths.toolpath import PathDepth
from meshes.surfaces.surface import Surface
from meshes.tets.tetrahedra import TetMesh
from meshes.voxels.mesh_sampling import triangle_distance
from tissue.show.figures.figure import BONE, draw_arrow, figure, save, styled
from tissue.show.figures.rendering import Camera, Shaded, draw_axes, draw_shaded, paint

if TYPE_CHECKING:
    import pyvista
    from matplotlib.axes import Axes

__all__ = [
    "SOFT_HU",
    "draw_ct_bone",
    "draw_ct_histogram",
    "draw_ct_organ",
    "draw_ct_slices",
    "draw_path_depth",
]

Line = Literal["solid", "dashed", "dotted"]
BONE_HU, SOFT_HU = (-200.0, 1300.0), (-160.0, 240.0)
"""Grey values from black to white for bone and for soft tissue.

The first range covers fat to cortical bone, the second is the usual abdominal window.
"""
VIEWS = ((0, 1, 2, "axial"), (0, 2, 1, "coronal"), (1, 2, 0, "sagittal"))
"""Axes of a slice to the right and upward, the axis through it, and its name."""
AXES = ("left", "back", "head")
BODY, SITE, PATH = "#E69F00", "#D55E00", "#CC79A7"
OTHERS = ("#56B4E9", "#009E73", "#F0E442", "#0072B2")
"""Colours of outlines after Okabe and Ito (2008)."""
LINES: tuple[Line, ...] = ("solid", "dashed", "dotted")
"""Strokes of the outlines. The next stroke is used after all colours."""
NORMAL_MM = 12.0


@styled
def draw_ct_slices(
    image: Image,
    path: Path,
    *,
    body: tuple[str, Image],
    others: Mapping[str, Image],
    centre_mm: NDArray[np.float64],
    normal: NDArray[np.float64] | None,
    points_mm: NDArray[np.float64] | None,
    title: str,
    window_HU: tuple[float, float] = BONE_HU,
) -> None:
    """Draw the slices to a file.

    Parameters
    ----------
    image
        Grey values around the bone.
    body
        Name of the bone, and an image that is above 0 inside it. The image lies on the same voxels,
        within its own extent.
    others
        Images of other structures in the same form, by name.
    centre_mm
        Intersection of the slices [mm, LPS]: the site, or the middle of the bone.
    normal
        Outward direction at the site. None without a site.
    points_mm
        Corners of a path [mm, LPS], shape (n, 3). None without a path.
    window_HU
        Hounsfield units from black to white. Images in other units use their own range.
    """
    from matplotlib.lines import Line2D

    origin = np.array(image.origin_mm)
    spacing = np.array(image.spacing_mm)
    shape = image.values.shape
    at = np.rint((centre_mm - origin) / spacing).astype(int).clip(0, np.array(shape) - 1)
    hounsfield = float(image.values.min()) < -100.0
    low, high = window_HU if hounsfield else np.percentile(image.values, (1, 99.8))
    outlined = [(body[1], BODY, LINES[0])]
    for number, field in enumerate(others.values()):
        outlined.append(
            (field, OTHERS[number % len(OTHERS)], LINES[number // len(OTHERS) % len(LINES)])
        )
    chart = figure(9.0, 3.7)
    panels = chart.subplots(
        1, 3, gridspec_kw={"wspace": 0.3, "left": 0.07, "right": 0.98, "bottom": 0.22, "top": 0.85}
    )
    for axes, (u, v, through, name) in zip(panels, VIEWS, strict=True):
        ends = [
            (origin[a] - 0.5 * spacing[a], origin[a] + spacing[a] * (shape[a] - 0.5))
            for a in (u, v)
        ]
        grey = np.take(image.values, int(at[through]), axis=through).T
        extent = (*ends[0], *ends[1])
        axes.imshow(
            grey,
            cmap="gray",
            vmin=low,
            vmax=high,
            origin="lower",
            extent=extent,
            interpolation="nearest",
        )
        place = float(origin[through] + spacing[through] * at[through])
        for field, colour, line in outlined:
            _outline(axes, field, (u, v, through), place, colour, line)
        if points_mm is not None:
            axes.plot(points_mm[:, u], points_mm[:, v], color=PATH, linewidth=1.2)
        if normal is not None:
            _draw_site(axes, centre_mm[[u, v]], (centre_mm + NORMAL_MM * normal)[[u, v]])
        axes.set(
            xlabel=f"{AXES[u]} [mm]",
            ylabel=f"{AXES[v]} [mm]",
            xlim=ends[0],
            ylim=ends[1],
            aspect="equal",
        )
        if v == 1:  # the patient's front is up, as radiologists have it
            axes.invert_yaxis()
        axes.set_title(f"{name}, {AXES[through]} {place:.1f} mm", size=9)
    chart.suptitle(title, size=10, y=0.98)
    handles = [
        Line2D([], [], color=colour, linestyle=line, label=name)
        for name, (_, colour, line) in zip((body[0], *others), outlined, strict=True)
    ]
    if normal is not None:
        handles.append(
            Line2D([], [], color=SITE, marker="o", markersize=4, label="site and normal")
        )
    if points_mm is not None:
        handles.append(Line2D([], [], color=PATH, label="path of the tip"))
    chart.legend(handles=handles, loc="lower center", ncols=min(len(handles), 5), frameon=False)
    save(chart, path)


def _outline(
    axes: "Axes",
    field: Image,
    order: tuple[int, int, int],
    place_mm: float,
    colour: str,
    line: Line,
) -> None:
    """Draw the line where a field is 0 in the slice at a place along its axis."""
    u, v, through = order
    at = round((place_mm - field.origin_mm[through]) / field.spacing_mm[through])
    if not 0 <= at < field.values.shape[through]:
        return
    values = np.take(field.values, at, axis=through).T
    x, y = (
        field.origin_mm[a] + field.spacing_mm[a] * np.arange(field.values.shape[a]) for a in (u, v)
    )
    if values.min() < 0.0 < values.max():
        axes.contour(
            x, y, values, levels=[0.0], colors=[colour], linestyles=[line], linewidths=[1.1]
        )


def _draw_site(axes: "Axes", centre: NDArray[np.float64], tip: NDArray[np.float64]) -> None:
    """Draw the site as a dot with an arrow along its normal."""
    draw_arrow(axes, centre, tip, SITE)
    axes.plot(*centre, "o", color=SITE, markersize=4)


AROUND_ORGAN_MM = 10.0


def draw_ct_organ(
    image: Image, path: Path, *, masks: Mapping[str, NDArray[np.bool_]], mesh: TetMesh, title: str
) -> None:
    """Draw slices through the middle of the smallest part with outlines.

    The outlines are those of the meshed organ and of the labels.

    Parameters
    ----------
    masks
        The organ first, then its parts, of the image's shape.
    mesh
        Tetrahedra of the organ in the frame of the image.
    """
    organ, *parts = masks
    spacing = np.array(image.spacing_mm)
    origin = np.array(image.origin_mm)
    low = (
        np.floor((1e3 * mesh.nodes_m.min(axis=0) - AROUND_ORGAN_MM - origin) / spacing)
        .astype(int)
        .clip(0)
    )
    high = (
        np.ceil((1e3 * mesh.nodes_m.max(axis=0) + AROUND_ORGAN_MM - origin) / spacing).astype(int)
        + 1
    )
    part = tuple(map(slice, low.tolist(), np.minimum(high, image.values.shape).tolist()))
    around = part_of(image, part)
    smallest = min(parts or [organ], key=lambda name: int(np.count_nonzero(masks[name])))
    middle = origin + spacing * np.argwhere(masks[smallest]).mean(axis=0)
    sizes = zip(around.origin_mm, around.spacing_mm, around.values.shape, strict=True)
    axes = [o + s * np.arange(n) for o, s, n in sizes]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    depth = -triangle_distance(mesh.nodes_m, mesh.surface, 1e-3 * grid).reshape(around.values.shape)
    draw_ct_slices(
        around,
        path,
        body=(f"{organ}, meshed", replace(around, values=depth.astype(np.float32))),
        others={
            name: replace(around, values=masks[name][part] - np.float32(0.5)) for name in parts
        },
        centre_mm=middle,
        normal=None,
        points_mm=None,
        title=title,
        window_HU=SOFT_HU,
    )


HEAD_PX, FOOT_PX, PATH_FOOT_PX, AXES_PX = 110, 150, 330, 150
"""Heights above and below the renderings, and edge of the small axes [pixel]."""
UNDER_MM = 2.0
"""Depth at which the density is read that a point of the surface shows."""
DENSITIES = (0.0, 1800.0)
COLOURS = "YlGnBu"
"""Colour map with light colours where bone is sparse, so that shading stays visible.

Colour-blind readers can distinguish its colours.
"""
FRONT = (0.3, -1.0, 0.25)
"""Direction to the eye of a bone without a site: from the patient's front left above."""


def draw_ct_bone(
    surface: Surface,
    path: Path,
    *,
    density: Image | None,
    centre_mm: NDArray[np.float64] | None,
    normal: NDArray[np.float64] | None,
    points_mm: NDArray[np.float64] | None,
    title: str,
) -> str | None:
    """Draw the bone to a file.

    Parameters
    ----------
    surface
        Bone in the frame of its image.
    density
        Apparent density [kg/m3]. None if it is unknown.
    centre_mm, normal
        Site [mm, LPS]. None without a site.
    points_mm
        Corners of a path [mm, LPS], shape (n, 3).

    Returns
    -------
    None, or the reason why it could not be drawn.
    """
    mesh = _painted(surface, density)
    eyes = _eyes(normal)

    def make() -> "list[tuple[pyvista.PolyData, Camera]]":
        return [(mesh, Camera.seeing(mesh.points, eye, up)) for eye, up in eyes.values()]

    def annotate(shaded: Shaded) -> None:
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import Normalize

        wide, tall = shaded.size_px
        foot = FOOT_PX / tall
        for axes, camera, left in zip(shaded.panels, shaded.cameras, (0.06, 0.84), strict=True):
            if points_mm is not None:
                axes.plot(*camera.pixels(points_mm).T, color=PATH, linewidth=1.5)
            if centre_mm is not None and normal is not None:
                _draw_site(axes, *camera.pixels(np.stack([centre_mm, centre_mm + 15.0 * normal])))
            draw_axes(shaded.chart.add_axes((left, 0.02, AXES_PX / wide, 0.9 * foot)), AXES, camera)
        if density is not None:
            bar = shaded.chart.add_axes((0.32, 0.62 * foot, 0.36, 0.13 * foot))
            mapped = ScalarMappable(Normalize(*DENSITIES), COLOURS)
            shaded.chart.colorbar(mapped, cax=bar, orientation="horizontal", extend="max")
            bar.set_xlabel(f"apparent density {UNDER_MM:g} mm under the surface [kg/m³]")

    return draw_shaded(
        make, path, annotate, margins_px=(HEAD_PX, FOOT_PX), title=title, names=list(eyes)
    )


def _eyes(
    normal: NDArray[np.float64] | None,
) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Return the directions to the eye and upward of each panel, by its title."""
    head = np.array([0.0, 0.0, 1.0])
    if normal is None:
        front = np.array(FRONT)
        return {"from the front": (front, head), "from the back": (front * [1.0, -1.0, 1.0], head)}
    upright = head if abs(normal[2]) < 0.9 else np.array([0.0, -1.0, 0.0])
    aside = np.cross(upright, normal)
    return {
        "along the site's axis": (normal, upright),
        "from aside": (aside + 0.25 * upright, upright),
    }


def _painted(surface: Surface, density: Image | None) -> "pyvista.PolyData":
    """Return the bone, each point in the colour of the density under it."""
    import pyvista
    from matplotlib import colormaps
    from scipy.ndimage import map_coordinates

    mesh = pyvista.PolyData.from_regular_faces(1e3 * surface.vertices_m, surface.faces.astype(int))
    mesh = mesh.compute_normals(split_vertices=False)
    if density is None:
        return paint(mesh, np.tile(BONE, (mesh.n_points, 1)))
    points = np.asarray(mesh.points) - UNDER_MM * np.asarray(mesh.point_data["Normals"])
    at = (points - np.array(density.origin_mm)) / np.array(density.spacing_mm)
    found = map_coordinates(density.values.astype(np.float32), at.T, order=1, mode="nearest")
    low, high = DENSITIES
    return paint(
        mesh, np.asarray(colormaps[COLOURS](np.clip((found - low) / (high - low), 0.0, 1.0)))[:, :3]
    )


OUTSIDE = "0.45"
PATH_COLOURS = "inferno_r"
AROUND_PATH_MM = 40.0
"""Minimum half width of the bone that is shown around the path [mm]."""


def draw_path_depth(
    surface: Surface, found: PathDepth, path: Path, *, normal: NDArray[np.float64], title: str
) -> str | None:
    """Draw a path over the bone around it, seen along the site's axis and from the side.

    Parameters
    ----------
    surface
        The bone in the frame of its image.
    found
        Points of the path and their depth, see `meshes.paths.toolpath.depth_along`.
    path
        File to write.
    normal
        Outward direction at the site, shape (3,).

    Returns
    -------
    None, or the reason why it could not be drawn.
    """
    points = found.points_mm
    half = max(AROUND_PATH_MM, 0.7 * float(np.ptp(points, axis=0).max()))
    corners = points.mean(axis=0) + half * (
        np.stack(np.meshgrid(*[[-1, 1]] * 3), axis=-1).reshape(-1, 3) * 0.6
    )
    mesh = _painted(surface, None)
    eyes = _eyes(normal)

    def make() -> "list[tuple[pyvista.PolyData, Camera]]":
        return [(mesh, Camera.seeing(corners, eye, up)) for eye, up in eyes.values()]

    def annotate(shaded: Shaded) -> None:
        from matplotlib import colormaps
        from matplotlib.collections import LineCollection

        middle = 0.5 * (found.depth_mm[1:] + found.depth_mm[:-1])
        deepest = max(found.deepest_mm, 1e-6)
        shades = colormaps[PATH_COLOURS](0.15 + 0.85 * np.clip(middle / deepest, 0.0, 1.0))
        inside = middle > 0.0

        def add_line(axes: "Axes", line: NDArray[np.float64]) -> None:
            pieces = np.stack([line[:-1], line[1:]], axis=1)
            axes.add_collection(
                LineCollection(list(pieces[~inside]), colors=OUTSIDE, linewidths=1.1)
            )
            axes.add_collection(
                LineCollection(list(pieces[inside]), colors=shades[inside], linewidths=2.2)
            )

        for axes, camera in zip(shaded.panels, shaded.cameras, strict=True):
            add_line(axes, camera.pixels(points))
        wide, tall = shaded.size_px
        draw_axes(
            shaded.chart.add_axes((0.02, 0.02, AXES_PX / wide, AXES_PX / tall)),
            AXES,
            shaded.cameras[0],
        )
        low = shaded.chart.add_axes(
            (0.2, 0.32 * PATH_FOOT_PX / tall, 0.75, 0.55 * PATH_FOOT_PX / tall)
        )
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        low.axhline(0.0, color="0.3", linewidth=0.8)
        add_line(low, np.column_stack([along, found.depth_mm]))
        low.autoscale_view()
        low.margins(x=0.0)
        low.invert_yaxis()
        low.set(xlabel="path length [mm]", ylabel="depth [mm]")
        low.set_title(f"deepest {found.deepest_mm:.1f} mm", loc="right", size=9)

    return draw_shaded(
        make, path, annotate, margins_px=(HEAD_PX, PATH_FOOT_PX), title=title, names=list(eyes)
    )


ALL, INSIDE, LEVEL = "0.6", "#E69F00", "#D55E00"
BINS = 160
RANGE_HU = (-1100.0, 2200.0)


@styled
def draw_ct_histogram(
    values: NDArray[np.int64],
    counts: NDArray[np.int64],
    inside: NDArray[np.number],
    path: Path,
    *,
    threshold: float | None,
    density: tuple[float, float] | None,
    title: str,
) -> None:
    """Draw the histogram to a file.

    Parameters
    ----------
    values, counts
        Whole values of the image, and number of voxels with each value.
    inside
        Values of the voxels of the bone.
    threshold
        Value above which a voxel is bone; None with a label.
    density
        Density per value and at value 0 [kg/m3]. None if it is unknown.
    """
    low = max(RANGE_HU[0], float(values[0]))
    high = min(RANGE_HU[1], float(values[-1]))
    edges = np.linspace(low, high, BINS)
    chart = figure(6.4, 3.4)
    axes = chart.add_axes((0.11, 0.16, 0.86, 0.62))
    axes.stairs(
        np.histogram(values, edges, weights=counts)[0], edges, color=ALL, fill=True, label="image"
    )
    axes.stairs(np.histogram(inside, edges)[0], edges, color=INSIDE, linewidth=1.4, label="bone")
    if threshold is not None:
        axes.axvline(threshold, color=LEVEL, linestyle="--", label=f"threshold {threshold:g}")
    axes.set_yscale("log")
    axes.set(xlim=(low, high), ylim=(0.7, None), xlabel="grey value [HU]", ylabel="voxels")
    axes.spines["right"].set_visible(False)
    axes.legend(frameon=False, loc="upper right")
    if density is not None:
        slope, offset = density

        def to_density(x: ArrayLike) -> NDArray[np.float64]:
            return slope * np.asarray(x, dtype=np.float64) + offset

        def to_value(y: ArrayLike) -> NDArray[np.float64]:
            return (np.asarray(y, dtype=np.float64) - offset) / slope

        upper = axes.secondary_xaxis("top", functions=(to_density, to_value))
        upper.set_xlabel("apparent density of bone [kg/m³]")
        upper.set_xticks(
            [ticks for ticks in range(0, 4000, 500) if offset <= ticks <= slope * high + offset]
        )
    else:
        axes.set_xlabel("grey value")
        axes.spines["top"].set_visible(False)
    chart.suptitle(title, size=10, y=0.98)
    save(chart, path)
