"""Shaded pictures of coloured surfaces, drawn by ``python -m tissue.figures.rendering JOB PICTURES`` in a process."""

import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue.system.offscreen import draw_apart

__all__ = ["Camera", "Coloured", "render"]

OVERSAMPLING = 2
"""Pixels drawn for a pixel shown, along each edge: smooth outlines where the graphics card smooths none."""
LIGHTS = (((-0.6, 0.7, 0.9), 0.74), ((0.9, 0.1, 0.7), 0.26), ((0.1, -0.9, 0.55), 0.34))
"""Direction (right, up, towards the eye) and strength of the lights: key, fill, rim."""


@dataclass(frozen=True)
class Camera:
    """A parallel projection.

    Attributes
    ----------
    towards_eye, up
        Directions in the world, at right angles.
    centre_mm
        Point in the middle of the picture.
    height_mm
        Height of the picture in the world.
    size
        Width and height [pixel].
    """

    towards_eye: tuple[float, float, float]
    up: tuple[float, float, float]
    centre_mm: tuple[float, float, float]
    height_mm: float
    size: tuple[int, int]


@dataclass(frozen=True)
class Coloured:
    """A surface with a colour for every point or every triangle.

    Attributes
    ----------
    points_mm, normals
        Points [mm] and unit normals, shape (n, 3).
    triangles
        Indices of points, shape (m, 3).
    colours
        Red, green and blue, uint8, shape (n, 3) or (m, 3).
    """

    points_mm: NDArray[np.float32]
    normals: NDArray[np.float32]
    triangles: NDArray[np.int64]
    colours: NDArray[np.uint8]


def render(make: Callable[[], tuple[list[Coloured], Camera]]) -> list[NDArray[np.uint8]] | str:
    """Draw each surface for itself on white.

    Parameters
    ----------
    make
        Called once, while the drawing process starts, for the surfaces and the camera.

    Returns
    -------
    Pictures of shape (height, width, 3), or why they could not be drawn.
    """
    with TemporaryDirectory(prefix="tissue-") as folder:
        job, pictures = Path(folder) / "job.npz", Path(folder) / "pictures.npz"

        def prepare() -> None:
            surfaces, camera = make()
            arrays = {f"{name}_{i}": value for i, one in enumerate(surfaces) for name, value in vars(one).items()}
            np.savez(job, allow_pickle=False, **arrays, **{k: np.array(v) for k, v in asdict(camera).items()})

        problem = draw_apart("tissue.figures.rendering", str(job), str(pictures), prepare=prepare)
        if problem is not None:
            return problem
        with np.load(pictures) as drawn:
            return [drawn[f"picture_{i}"] for i in range(len(drawn.files))]


def _main(job: str, pictures: str) -> None:
    """Draw the surfaces of a job as soon as a line on the standard input announces it."""
    _warm_up()
    sys.stdin.readline()
    with np.load(job) as file:
        arrays: dict[str, Any] = dict(file)
    width, height = (OVERSAMPLING * int(n) for n in arrays["size"])
    drawn = {}
    for index in range(sum(name.startswith("colours_") for name in arrays)):
        surface = {name: arrays[f"{name}_{index}"] for name in Coloured.__dataclass_fields__}
        large = _draw(surface, arrays, width, height)
        blocks = large.reshape(height // OVERSAMPLING, OVERSAMPLING, width // OVERSAMPLING, OVERSAMPLING, 3)
        drawn[f"picture_{index}"] = blocks.mean(axis=(1, 3)).round().astype(np.uint8)
    np.savez(pictures, allow_pickle=False, **drawn)


def _warm_up() -> None:
    """Load the libraries and start OpenGL while the job is still being made."""
    import pyvista

    plotter = pyvista.Plotter(off_screen=True, window_size=[8, 8])
    plotter.add_mesh(pyvista.Triangle())
    plotter.screenshot(None, return_img=True)
    plotter.close()


def _draw(surface: dict[str, Any], camera: dict[str, Any], width: int, height: int) -> NDArray[np.uint8]:
    """One surface, seen by the camera."""
    import pyvista

    plotter: Any = pyvista.Plotter(off_screen=True, window_size=[width, height], lighting="none")
    plotter.disable_anti_aliasing()
    plotter.render_window.SetMultiSamples(0)
    plotter.set_background("white")
    mesh = pyvista.PolyData.from_regular_faces(surface["points_mm"], surface["triangles"])
    mesh.point_data["Normals"] = surface["normals"]
    mesh.point_data.active_normals_name = "Normals"
    where = "point" if len(surface["colours"]) == mesh.n_points else "cell"
    (mesh.point_data if where == "point" else mesh.cell_data)["colours"] = surface["colours"]
    plotter.add_mesh(
        mesh,
        scalars="colours",
        rgb=True,
        preference=where,
        smooth_shading=False,
        interpolation="Phong",
        ambient=0.2,
        diffuse=0.9,
        specular=0.08,
        specular_power=12.0,
        show_scalar_bar=False,
    )
    towards, up, centre = camera["towards_eye"], camera["up"], camera["centre_mm"]
    right = np.cross(up, towards)
    for (a, b, c), strength in LIGHTS:
        plotter.add_light(
            pyvista.Light(
                position=centre + 1e3 * (a * right + b * up + c * towards),
                focal_point=centre,
                light_type="scene light",
                intensity=strength,
            )
        )
    plotter.camera.position = centre + 1e3 * towards
    plotter.camera.focal_point = centre
    plotter.camera.up = up
    plotter.camera.parallel_projection = True
    plotter.camera.parallel_scale = 0.5 * float(camera["height_mm"])
    plotter.camera.clipping_range = (1.0, 2e3)
    picture: NDArray[np.uint8] = plotter.screenshot(None, return_img=True)
    plotter.close()
    return picture[..., :3]


if __name__ == "__main__":
    _main(*sys.argv[1:])
