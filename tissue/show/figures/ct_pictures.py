"""Figures of an imported CT: slices, histogram, bone, organ and depth of a tool path."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import cycle, product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Flags, Ints
from meshes.ct.density import DensityLaw
from meshes.ct.extraction import cropped
from meshes.ct.inspection import Histogram
from meshes.images.frame import Image
from meshes.paths.toolpath import PathDepth
from meshes.surfaces.surface import Surface
from meshes.tets.tetrahedra import TetMesh
from tissue.show.figures.figure import BONE, draw_arrow, panelled, plain, save, styled
from tissue.show.figures.rendering import Camera, Shaded, draw_axes, draw_shaded, paint

if TYPE_CHECKING:
    import pyvista
    from matplotlib.axes import Axes

BONE_HU = (-200.0, 1300.0)
SOFT_HU = (-160.0, 240.0)
"""CT values [HU] shown as black and as white in pictures of soft tissue.

This is the usual abdominal window. `BONE_HU` is the range for pictures of bone, from fat to
cortical bone.
"""
VIEWS = ((0, 1, 2, "axial"), (0, 2, 1, "coronal"), (1, 2, 0, "sagittal"))
"""For each slice: axes to the right and upward, axis perpendicular to the slice, and name."""
AXES = ("left", "back", "head")
BODY = "#E69F00"
SITE = "#D55E00"
PATH = "#CC79A7"
OTHERS = ("#56B4E9", "#009E73", "#F0E442", "#0072B2")
"""Colours of outlines after Okabe and Ito (2008)."""
LINES = ("solid", "dashed", "dotted")
"""Line styles of outlines. After all colours were used, the next line style is taken."""
NORMAL_MM = 12.0
"""Length [mm] of the arrow that shows the normal of the bone's surface in CT slices.

An arrow of this length is visible in slices of a joint.
"""


@dataclass(frozen=True, eq=False)
class Marks:
    """Tool site and tool path to mark in pictures of a bone.

    Attributes
    ----------
    centre_mm
        Position [mm, LPS] of the site where the tool works. Without a site, it is the point where
        the slices intersect (for example, the middle of the bone), or None.
    normal
        Outward normal of the bone's surface at the site; None if there is no site.
    points_mm
        Corners of the tool path [mm, LPS], shape (n, 3); None if there is no path.
    """

    centre_mm: Array | None
    normal: Array | None = None
    points_mm: Array | None = None

    def arrow_mm(self, length_mm: float) -> Array:
        """Return start and end [mm] of the arrow from the site along the normal, shape (2, 3).

        Without a site, the result is empty, shape (0, 3).
        """
        if self.centre_mm is None or self.normal is None:
            return np.zeros((0, 3))
        return np.stack([self.centre_mm, self.centre_mm + length_mm * self.normal])

    def draw(self, axes: "Axes", projected: Callable[[Array], Array], length_mm: float) -> None:
        """Draw the path, and the site as a dot with an arrow along the normal.

        Parameters
        ----------
        axes
            Axes to draw on.
        projected
            Function that projects points [mm], shape (n, 3), onto the panel and returns their
            coordinates in the panel, shape (n, 2).
        length_mm
            Length of the arrow [mm].
        """
        if self.points_mm is not None:
            label = "path of the tip"
            axes.plot(*projected(self.points_mm).T, color=PATH, linewidth=1.3, label=label)
        if self.normal is not None:
            start, end = projected(self.arrow_mm(length_mm))
            draw_arrow(axes, start, end, SITE)
            axes.plot(*start, "o", color=SITE, markersize=4, label="site and normal")


@styled
def draw_ct_slices(
    image: Image,
    path: Path,
    outlines: "Mapping[str, pyvista.PolyData]",
    marks: Marks,
    *,
    window_HU: tuple[float, float] = BONE_HU,
) -> None:
    """Draw an axial, a coronal and a sagittal slice of a CT to a file.

    Parameters
    ----------
    image
        CT image of the region around the bone.
    outlines
        Surface [mm, LPS] of each structure to outline, keyed by name; the bone comes first.
    marks
        Site and path to mark. The slices intersect at `marks.centre_mm`.
    window_HU
        Two CT values [HU]: the first is drawn black, the second white. For an image in other units,
        the 1 % and 99.8 % quantiles of its values are used.
    """
    from matplotlib.collections import LineCollection
    from matplotlib.lines import Line2D

    assert marks.centre_mm is not None
    origin = np.array(image.origin_mm)
    spacing = np.array(image.spacing_mm)
    shape = np.array(image.values.shape)
    at = np.rint((marks.centre_mm - origin) / spacing).astype(int).clip(0, shape - 1)
    # air and fat are far below 0 HU; other images have no negative values or small ones
    hounsfield = float(image.values.min()) < -100.0
    # 1 and 99.8 %: a few bright voxels, such as metal, do not darken the image
    low, high = window_HU if hounsfield else np.percentile(image.values, (1, 99.8))
    styles = [(BODY, "solid"), *((colour, line) for line, colour in product(LINES, OTHERS))]
    looks: list[dict[str, Any]] = [{"color": colour, "linestyle": line} for colour, line in styles]
    # inches: three near square panels, and the legend below
    chart, panels = panelled(image.source, (9.0, 3.9), 1, 3, layout="compressed")
    for axes, (u, v, through, name) in zip(panels, VIEWS, strict=True):
        plane = [u, v]
        ends = np.stack([origin - 0.5 * spacing, origin + spacing * (shape - 0.5)])[:, plane]
        axes.imshow(
            np.take(image.values, int(at[through]), axis=through).T,
            cmap="gray",
            vmin=low,
            vmax=high,
            origin="lower",
            extent=ends.T.ravel(),
            interpolation="nearest",
        )
        place = float(origin[through] + spacing[through] * at[through])
        for outline, look in zip(outlines.values(), cycle(looks), strict=False):
            cut = outline.slice(normal=np.eye(3)[through], origin=[place] * 3)
            lines = np.asarray(cut.points)[cut.lines.reshape(-1, 3)[:, 1:]]
            axes.add_collection(LineCollection(list(lines[..., plane]), linewidths=1.1, **look))
        marks.draw(axes, partial(np.take, indices=plane, axis=1), NORMAL_MM)
        axes.set(xlabel=f"{AXES[u]} [mm]", ylabel=f"{AXES[v]} [mm]", aspect="equal")
        # The arrow of a site at the edge of the image, and its path, lie outside of it.
        marked = [marks.arrow_mm(NORMAL_MM)]
        if marks.points_mm is not None:
            marked.append(marks.points_mm)
        shown = np.vstack([ends, np.vstack(marked)[:, plane]])
        x, y = np.stack([shown.min(axis=0), shown.max(axis=0)], axis=1)
        axes.set(xlim=x, ylim=y, facecolor="black")
        if v == 1:  # the patient's front is up, as radiologists have it
            axes.invert_yaxis()
        axes.set_title(f"{name}, {AXES[through]} {place:.1f} mm")
    handles = [
        Line2D([], [], label=name, **look)
        for name, look in zip(outlines, cycle(looks), strict=False)
    ]
    handles += panels[0].get_legend_handles_labels()[0]
    chart.legend(handles=handles, loc="outside lower center", ncols=5)
    save(chart, path)


def mesh_of(vertices_mm: Array, faces: Ints) -> "pyvista.PolyData":
    """Return a surface for pyvista from vertices [mm], shape (n, 3), and faces, shape (m, 3)."""
    import pyvista

    return pyvista.PolyData.from_regular_faces(vertices_mm, faces.astype(int))


def outline_of(image: Image, mask: Flags) -> "pyvista.PolyData":
    """Return the surface [mm, LPS] around the voxels that a mask selects in an image."""
    import pyvista

    grid = pyvista.ImageData(
        dimensions=mask.shape, spacing=image.spacing_mm, origin=image.origin_mm
    )
    grid.point_data["inside"] = mask.ravel(order="F").astype(np.uint8)
    return grid.contour([0.5], scalars="inside")


AROUND_ORGAN_MM = 10.0
"""Width [mm] of the surroundings that are shown around an organ."""


def draw_ct_organ(image: Image, path: Path, *, masks: Mapping[str, Flags], mesh: TetMesh) -> None:
    """Draw CT slices, with outlines, through the middle of the organ's smallest part.

    The outlines show the mesh of the organ and the segmented parts of the organ.

    Parameters
    ----------
    masks
        Masks with the shape of `image.values`, keyed by name: first the organ, then its parts.
    mesh
        Tetrahedral mesh of the organ in the frame of the image.
    """
    organ, *parts = masks
    nodes_mm = 1e3 * mesh.nodes_m
    low = (nodes_mm.min(axis=0) - AROUND_ORGAN_MM).tolist()
    high = (nodes_mm.max(axis=0) + AROUND_ORGAN_MM).tolist()
    # a slice through the organ's middle might miss a small part
    smallest = min(parts or [organ], key=lambda name: int(np.count_nonzero(masks[name])))
    outlines = {f"{organ}, meshed": mesh_of(nodes_mm, mesh.surface)}
    outlines |= {name: outline_of(image, masks[name]) for name in parts}
    marks = Marks(middle_of(image, masks[smallest]))
    around = cropped(image, (tuple(low), tuple(high)))
    draw_ct_slices(around, path, outlines, marks, window_HU=SOFT_HU)


def middle_of(image: Image, mask: Flags) -> Array:
    """Return the mean position [mm, LPS] of the voxels that a mask selects in an image."""
    places = np.argwhere(mask).mean(axis=0)
    return np.asarray(np.array(image.origin_mm) + np.array(image.spacing_mm) * places)


HEAD_PX = 110
FOOT_PX = 150
AXES_PX = 150
"""Width and height [pixels] of the small coordinate axes below the renderings."""
UNDER_MM = 2.0
"""Depth [mm] below the surface of the bone at which the shown density is read.

At the surface itself, the density is too low, because voxels are partly outside the bone.
"""
DENSITIES = (0.0, 1800.0)
"""Range of densities that the colours show [kg/m3], up to dense cortical bone."""
COLOURS = "YlGnBu"
"""Matplotlib colour map of density. Low densities are light, so that shading is visible.

Colour-blind readers can distinguish the colours.
"""
FRONT = (0.3, -1.0, 0.25)
"""Direction from the bone to the camera if no site is given: the patient's front, left and above.
"""


def draw_ct_bone(
    surface: Surface, path: Path, marks: Marks, *, density: Image | None, title: str
) -> str | None:
    """Write a picture file that shows a bone from two directions.

    Parameters
    ----------
    surface
        Surface of the bone, in the frame of the CT image (LPS).
    marks
        Tool site and tool path to mark.
    density
        Image of the apparent density [kg/m3], which determines the colours of the bone. None if the
        density is not known.

    Returns
    -------
    None, or the reason why the picture could not be drawn.
    """
    eyes = _eyes(marks.normal)

    def make() -> "list[tuple[pyvista.PolyData, Camera]]":
        mesh = _painted(surface, density)
        return [(mesh, Camera.seeing(mesh.points, eye, up)) for eye, up in eyes.values()]

    def annotate(shaded: Shaded) -> None:
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import Normalize

        wide, tall = shaded.size_px
        foot = FOOT_PX / tall
        for axes, camera, left in zip(shaded.panels, shaded.cameras, (0.06, 0.84), strict=True):
            # a triad under the outer half of each panel, the colour bar between them
            # arrows of 15 mm, visible next to a bone of some centimetres
            marks.draw(axes, camera.pixels, 15.0)
            draw_axes(shaded.chart.add_axes((left, 0.02, AXES_PX / wide, 0.9 * foot)), AXES, camera)
        if density is not None:
            bar = shaded.chart.add_axes((0.32, 0.62 * foot, 0.36, 0.13 * foot))
            mapped = ScalarMappable(Normalize(*DENSITIES), COLOURS)
            shaded.chart.colorbar(mapped, cax=bar, orientation="horizontal", extend="max")
            bar.set_xlabel(f"apparent density {UNDER_MM:g} mm under the surface [kg/m³]")

    return draw_shaded(
        make, path, annotate, margins_px=(HEAD_PX, FOOT_PX), title=title, names=list(eyes)
    )


def _eyes(normal: Array | None) -> dict[str, tuple[Array, Array]]:
    """Return the direction to the camera and the upward direction of each panel, keyed by title."""
    head = np.array([0.0, 0.0, 1.0])
    if normal is None:
        front = np.array(FRONT)
        return {"from the front": (front, head), "from the back": (front * [1.0, -1.0, 1.0], head)}
    # the head cannot be up in a view along the head's direction; then the front of the patient is
    # up
    upright = head if abs(normal[2]) < 0.9 else np.array([0.0, -1.0, 0.0])
    # from the side and a little from above, so that the arrow and the face are both visible
    aside = np.cross(upright, normal) + 0.25 * upright
    return {"along the site's axis": (normal, upright), "from aside": (aside, upright)}


def _painted(surface: Surface, density: Image | None) -> "pyvista.PolyData":
    """Return the surface of a bone, coloured by the density below each point."""
    from matplotlib import colormaps
    from scipy.ndimage import map_coordinates

    mesh = mesh_of(1e3 * surface.vertices_m, surface.faces).compute_normals(split_vertices=False)
    if density is None:
        return paint(mesh, np.tile(BONE, (mesh.n_points, 1)))
    points = np.asarray(mesh.points) - UNDER_MM * np.asarray(mesh.point_data["Normals"])
    at = (points - np.array(density.origin_mm)) / np.array(density.spacing_mm)
    found = map_coordinates(density.values.astype(np.float32), at.T, order=1, mode="nearest")
    low, high = DENSITIES
    return paint(
        mesh, np.asarray(colormaps[COLOURS](np.clip((found - low) / (high - low), 0.0, 1.0)))[:, :3]
    )


@styled
def draw_path_depth(found: PathDepth, path: Path, *, title: str) -> None:
    """Plot the depth of a tool path below a bone's surface over the distance along the path."""
    chart, (axes,) = panelled(title, (6.4, 3.0))
    steps_mm = np.linalg.norm(np.diff(found.points_mm, axis=0), axis=1)
    along_mm = np.concatenate([[0.0], np.cumsum(steps_mm)])
    axes.axhline(0.0, color="0.3", linewidth=0.8, label="surface")
    axes.plot(along_mm, found.depth_mm, color=PATH, label="path of the tip")
    axes.invert_yaxis()
    axes.set(xlabel="path length [mm]", ylabel="depth [mm]")
    axes.set_title(f"deepest {found.deepest_mm:.1f} mm", loc="right")
    plain([axes])
    save(chart, path)


ALL = "0.6"
INSIDE = "#E69F00"
LEVEL = "#D55E00"
BINS = 160
"""Number of bin edges of the histogram of CT values.

A bin is 20 HU wide, which is about the noise of a CT.
"""
RANGE_HU = (-1100.0, 2200.0)
"""Range of the histogram of CT values [HU], from air to dense cortical bone, without metal."""


@styled
def draw_ct_histogram(
    histogram: Histogram,
    inside: NDArray[np.number],
    path: Path,
    *,
    threshold: float | None,
    law: DensityLaw | None,
    title: str,
) -> None:
    """Draw the histogram of a CT image to a file.

    Parameters
    ----------
    histogram
        Histogram of the image.
    inside
        Values of the voxels inside the bone.
    threshold
        Value above which a voxel counts as bone; None if the bone was segmented by a label.
    law
        Density as a function of the voxel value; None if this function is not known.
    """
    values = histogram.values
    low = max(RANGE_HU[0], float(values[0]))
    high = min(RANGE_HU[1], float(values[-1]))
    edges = np.linspace(low, high, BINS)
    chart, (axes,) = panelled(title, (6.4, 3.4))
    shown, _ = np.histogram(values, edges, weights=histogram.counts)
    axes.stairs(shown, edges, color=ALL, fill=True, label="image")
    shown, _ = np.histogram(inside, edges)
    axes.stairs(shown, edges, color=INSIDE, linewidth=1.4, label="bone")
    if threshold is not None:
        axes.axvline(threshold, color=LEVEL, linestyle="--", label=f"threshold {threshold:g}")
    axes.set_yscale("log")
    # single voxels are visible on the logarithmic axis
    axes.set(xlim=(low, high), ylim=(0.7, None), xlabel="grey value", ylabel="voxels")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="upper right")
    if law is not None:
        slope = law.slope_kg_m3
        offset = law.offset_kg_m3
        axes.set_xlabel("grey value [HU]")
        upper = axes.secondary_xaxis(
            "top", functions=(lambda x: slope * x + offset, lambda y: (y - offset) / slope)
        )
        upper.set_xlabel("apparent density of bone [kg/m³]")
        upper.set_xticks(
            # densities beyond 4000 kg/m3 are not tissue
            [ticks for ticks in range(0, 4000, 500) if offset <= ticks <= slope * high + offset]
        )
    save(chart, path)
