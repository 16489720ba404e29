"""Off-screen renderings of coloured surfaces.

Run as ``python -m tissue.show.figures.rendering FOLDER`` in a subprocess.
"""

import pickle
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array, Bytes
from tissue.show.figures.figure import DPI, draw_arrow, figure, halo, save
from tissue.system.offscreen import draw_apart

if TYPE_CHECKING:
    import pyvista
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PANEL_PX = 780
GAP_PX = 40
"""Width of the space between two panels [pixels]; a panel is `PANEL_PX` wide.

With these values, two panels are 8 inches wide at 200 dpi.
"""
OVERSAMPLING = 2
"""Number of rendered pixels per pixel of the picture, along each axis.

In a PNG picture, matplotlib averages the rendered pixels, so that outlines are smooth. Vector files
contain all rendered pixels.
"""
AMBIENT = 0.34
FIELD_AMBIENT = 0.72
ALL_LIGHT = 1.08
"""Total light on a surface: ambient light plus lamps.

The ambient part is `AMBIENT` for bone and `FIELD_AMBIENT` for fields. Fields have little shade, so
that their colours agree with the colour bar.
"""


@dataclass(frozen=True)
class Camera:
    """Camera with parallel projection.

    Attributes
    ----------
    towards_eye, up
        Direction to the camera, and upward direction of the picture. Both are in the world frame
        and perpendicular to each other.
    centre_mm
        Position [mm], in the world frame, of the middle of the picture.
    height_mm
        Height [mm] of the region that the picture shows.
    size
        Width and height [pixels].
    """

    towards_eye: tuple[float, ...]
    up: tuple[float, ...]
    centre_mm: tuple[float, ...]
    height_mm: float
    size: tuple[int, int]

    @classmethod
    def seeing(cls, points_mm: ArrayLike, towards_eye: ArrayLike, up: ArrayLike) -> "Camera":
        """Return an upright camera that looks from a given direction and sees all points."""
        towards = np.array(towards_eye) / np.linalg.norm(towards_eye)
        upright = np.asarray(up) - (np.asarray(up) @ towards) * towards
        upright /= np.linalg.norm(upright)
        axes = np.stack([np.cross(upright, towards), upright, towards])
        seen = np.asarray(points_mm) @ axes.T
        first = seen.min(axis=0)
        last = seen.max(axis=0)
        # a border of 3 % on each side
        width, height = 1.06 * (last - first)[:2]
        # limits of the panel's height, so that very flat or tall objects leave space for legends;
        # it is rounded to an even number, though an odd one renders as well
        tall = int(np.clip(PANEL_PX * height / width, 0.45 * PANEL_PX, 1.15 * PANEL_PX)) // 2 * 2
        height = max(height, width * tall / PANEL_PX)
        centre = 0.5 * (first + last) @ axes
        return cls(
            tuple(towards),
            tuple(upright),
            tuple(centre),
            height_mm=float(height),
            size=(PANEL_PX, tall),
        )

    def pixels(self, points_mm: ArrayLike) -> Array:
        """Return the pixel coordinates of points, shape (n, 2).

        The coordinates are counted to the right and down from the upper left corner.
        """
        axes = np.stack([np.cross(self.up, self.towards_eye), self.up])
        right, upward = (
            axes @ (np.asarray(points_mm) - self.centre_mm).T * (self.size[1] / self.height_mm)
        )
        return np.column_stack([0.5 * self.size[0] + right, 0.5 * self.size[1] - upward])


def paint(surface: "pyvista.PolyData", colours: Array) -> "pyvista.PolyData":
    """Set the colours of a surface, and return the surface.

    `colours` contains red, green and blue from 0 to 1, shape (n, 3), for the n points or the n
    triangles of the surface.
    """
    data = surface.point_data if len(colours) == surface.n_points else surface.cell_data
    # VTK draws bytes as they are; other numbers would go through a colour table
    data["colours"] = np.rint(255.0 * colours).astype(np.uint8)
    return surface


@dataclass(frozen=True)
class Shaded:
    """Figure with renderings side by side, which can be annotated.

    Attributes
    ----------
    chart
        Figure with the renderings.
    panels
        Axes, one for each rendering.
    cameras
        Camera of each panel.
    size_px
        Width and height of the figure [pixels].
    """

    chart: "Figure"
    panels: "list[Axes]"
    cameras: list[Camera]
    size_px: tuple[int, int]


def draw_shaded(
    make: "Callable[[], list[tuple[pyvista.PolyData, Camera]]]",
    path: Path,
    annotate: Callable[[Shaded], None],
    *,
    margins_px: tuple[int, int],
    title: str = "",
    names: Sequence[str] = (),
    ambient: float = AMBIENT,
) -> str | None:
    """Render surfaces side by side with scale bars, annotate the figure, and write it to a file.

    Parameters
    ----------
    make
        Function that returns coloured surfaces with normals, and the camera of each surface. The
        function is called once.
    path
        File to write.
    annotate
        Function that adds legends, colour bars and marks to the figure.
    margins_px
        Heights above and below the renderings [pixels].
    title, names
        Text above all panels, and text above each panel.
    ambient
        Fraction of ambient light. A larger fraction gives less shade.

    Returns
    -------
    None, or the reason why the surfaces could not be rendered.
    """
    cameras: list[Camera] = []

    def prepare() -> bytes:
        made = make()
        cameras.extend(camera for _, camera in made)
        return pickle.dumps([(surface, asdict(camera)) for surface, camera in made])

    module = "tissue.show.figures.rendering"
    with TemporaryDirectory(prefix="tissue-") as folder:
        problem = draw_apart(module, folder, str(ambient), prepare=prepare)
        if problem is not None:
            return problem
        with np.load(Path(folder) / "pictures.npz") as drawn:
            pictures = list(drawn.values())
    head, foot = margins_px
    tall = max(len(picture) for picture in pictures) // OVERSAMPLING
    wide = pictures[0].shape[1] // OVERSAMPLING
    size = len(pictures) * (wide + GAP_PX) - GAP_PX, tall + head + foot
    chart = figure(size[0] / DPI, size[1] / DPI)
    panels = []
    for index, (picture, camera) in enumerate(zip(pictures, cameras, strict=True)):
        high = len(picture) // OVERSAMPLING
        left = index * (wide + GAP_PX)
        low = foot + tall - high
        axes = chart.add_axes((left / size[0], low / size[1], wide / size[0], high / size[1]))
        ends = (-0.5, wide - 0.5, high - 0.5, -0.5)
        axes.imshow(picture, interpolation="antialiased", extent=ends)
        axes.set_axis_off()
        _draw_scale(axes, camera)
        panels.append(axes)
    for axes, name in zip(panels, names, strict=False):
        axes.set_title(name, size=10)
    # 38 pixels below the upper edge, above the titles of the panels; lower with a second line
    middle = 38 + 8 * title.count("\n")
    chart.text(0.5, 1.0 - middle / size[1], title, ha="center", va="center", size=11)
    annotate(Shaded(chart, panels, cameras, size))
    save(chart, path)
    return None


def _main(name: str, ambient: str) -> None:
    """Read surfaces from standard input, render them, and write the pictures into a folder."""
    # pyvista is loaded while the surfaces are still being made
    import pyvista  # noqa: F401

    received = pickle.load(sys.stdin.buffer)
    drawn = [_draw(surface, Camera(**camera), float(ambient)) for surface, camera in received]
    np.savez(Path(name) / "pictures.npz", *drawn, allow_pickle=False)


def _draw(mesh: "pyvista.PolyData", camera: Camera, ambient: float) -> Bytes:
    """Render one surface."""
    import pyvista

    window = [OVERSAMPLING * pixels for pixels in camera.size]
    plotter = pyvista.Plotter(off_screen=True, window_size=window)
    plotter.disable_anti_aliasing()
    plotter.background_color = pyvista.Color("white")
    mesh.point_data.active_normals_name = "Normals"
    plotter.add_mesh(
        mesh,
        scalars="colours",
        rgb=True,
        preference="point" if "colours" in mesh.point_data else "cell",
        smooth_shading=False,  # the mesh has its own normals; pyvista would compute others
        interpolation="Phong",
        ambient=ambient,
        diffuse=ALL_LIGHT - ambient,
        specular=0.08,
        specular_power=12.0,
        show_scalar_bar=False,
    )
    # a metre away: the eye is outside of every object, which is some centimetres large
    centre = np.array(camera.centre_mm)
    eye = centre + 1e3 * np.array(camera.towards_eye)
    plotter.camera_position = [eye.tolist(), centre.tolist(), list(camera.up)]
    plotter.camera.parallel_projection = True
    plotter.camera.parallel_scale = 0.5 * camera.height_mm
    # from the eye, which is 1 m before the centre, to 1 m behind it [mm]
    plotter.camera.clipping_range = (1.0, 2e3)
    drawn = np.array(plotter.screenshot(None, return_img=True))[..., :3]
    plotter.close()
    return drawn


LENGTHS_MM = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)


def round_length(longest_mm: float) -> float:
    """Return the largest length among 1, 2, 5, 10, ... mm that does not exceed a limit."""
    return max(step for step in LENGTHS_MM if step <= max(longest_mm, LENGTHS_MM[0]))


def _draw_scale(axes: "Axes", camera: Camera) -> None:
    """Draw a scale bar of a round length.

    The bar is valid everywhere in the picture because the projection is parallel.
    """
    per_mm = camera.size[1] / camera.height_mm
    # at most a quarter of the width
    length = round_length(0.25 * camera.size[0] / per_mm)
    # 20 and 16 pixels from the corner
    right = camera.size[0] - 20.0
    left = right - length * per_mm
    y = camera.size[1] - 16.0
    axes.plot([left, right], [y, y], color="0.1", linewidth=2.2, path_effects=halo())
    middle = 0.5 * (left + right)
    words = f"{length:g} mm"
    # 8 pixels above the bar
    axes.text(middle, y - 8.0, words, ha="center", va="bottom", size=9, path_effects=halo())


def draw_axes(axes: "Axes", names: Sequence[str], camera: Camera) -> None:
    """Draw labelled arrows for the world axes as the camera sees these axes."""
    view = np.stack([np.cross(camera.up, camera.towards_eye), camera.up])
    # arrows of length 0.8 and their names fit; up is wider, since z points up in most views
    axes.set(xlim=(-1.5, 1.5), ylim=(-0.75, 1.35), aspect="equal")
    axes.set_axis_off()
    for along, name in zip(0.8 * view.T, names, strict=True):
        # an axis that points at the viewer has no visible length and no direction for its name
        if np.hypot(*along) < 0.2:
            continue
        draw_arrow(axes, (0.0, 0.0), along, "0.2", width=1.0)
        # the name is 0.12 beyond the arrow's tip
        x, y = along * (1.0 + 0.12 / np.hypot(*along))
        axes.text(x, y, name, ha="left" if along[0] > -0.05 else "right", va="center", size=9)


if __name__ == "__main__":
    _main(*sys.argv[1:])
