"""Window of `tissue view` for an imported bone: a click sets the site, and a key saves it."""

import sys
from pathlib import Path

import numpy as np

from meshes.base.errors import InputError, as_vector
from meshes.surfaces.site import normal_near, sample_surface
from meshes.surfaces.surface import Surface, read_surface
from tissue.scene.texts import anatomy_of, save_site
from tissue.show.figures.figure import BONE
from tissue.show.viewer.plotter import add_text, free_keys, in_words, new_plotter, on_click, picked

SIZE = (1400, 950)
SITE = "#0072B2"
UNSAVED = "#D55E00"
SAMPLES = 60_000
"""Number of surface points from which normals are estimated: about one per square millimetre."""
EYE = np.array([0.35, -1.0, 0.35])
"""Direction from the bone to the camera if there is no site.

The view is from the front of the patient, slightly from the left and above.
"""
ASIDE = 0.6
"""Ratio of the camera's lateral offset to its distance along the normal.

With this offset, the arrow along the normal is visible.
"""
MARK = 0.012
ARROW = 0.16
"""Radius of the mark and length of the arrow, relative to the size of the bone."""
ZOOM = 0.9
"""Zoom factor that leaves space for the text above the bone."""
HELP = "click: put the site there    Return: save it into scene.toml    q: close"


def is_imported(folder: Path) -> bool:
    """Return whether a folder contains an imported bone and no run."""
    return (
        all((folder / name).is_file() for name in ("scene.toml", "bone.ply"))
        and not (folder / "summary.json").exists()
    )


class SiteWindow:
    """Window with an imported bone and the site on the bone where the tool works.

    Parameters
    ----------
    folder
        Folder written by `tissue import`.
    off_screen
        If true, the view is drawn off screen for a file, and without help text.

    Attributes
    ----------
    plotter
        PyVista's plotter.
    centre_mm, normal
        Centre [mm] and outward normal of the shown site in the frame of the image (LPS), each of
        shape (3,). Both are None if there is no site.
    text
        Text about the site.
    """

    def __init__(self, folder: Path, *, off_screen: bool) -> None:
        import pyvista

        self._scene = folder / "scene.toml"
        anatomy = anatomy_of(self._scene)
        self._surface = _bone(folder, anatomy)
        self._samples = sample_surface(*self._surface.scanned, SAMPLES)
        self._size_mm = max(self._surface.report.size_mm)
        self.centre_mm, self.normal = (
            as_vector(anatomy.get(key)) for key in ("centre_mm", "normal")
        )
        if self.centre_mm is not None and self.normal is None:
            self.normal = normal_near(self._samples, 1e-3 * self.centre_mm)
        self.text = ""
        self.plotter = new_plotter(
            SIZE, title=f"tissue: {folder.absolute().name}", off_screen=off_screen
        )
        bone = pyvista.PolyData.from_regular_faces(
            1e3 * self._surface.vertices_m, self._surface.faces.astype(int)
        )
        # little ambient light shows the shape of the bone
        look = {"color": BONE, "smooth_shading": True, "ambient": 0.15, "specular": 0.1}
        self._bone = self.plotter.add_mesh(bone, name="bone", **look)
        self.plotter.add_axes(
            xlabel="left", ylabel="back", zlabel="head", color="black", line_width=3
        )
        self._words = add_text(self.plotter, "", (0.012, 0.9), size=11)
        if not off_screen:
            # one line below the text about the site, which has two lines from 0.9 on
            add_text(self.plotter, HELP, (0.012, 0.86))
            self.plotter.add_key_event("Return", self.save)
        self._draw("site in scene.toml", SITE)
        self._aim()

    def click(self, x: int, y: int) -> bool:
        """Move the site to the point of the bone under a pixel; return False if there is no bone.

        `x` and `y` are counted in pixels from the lower left corner of the window.
        """
        found = picked(self.plotter, self._bone, x, y)
        if found is None:
            return False
        self.centre_mm = found
        self.normal = normal_near(self._samples, 1e-3 * self.centre_mm)
        self._draw("picked, not saved yet: press Return", UNSAVED)
        return True

    def save(self) -> None:
        """Write the site into the scene file."""
        if self.centre_mm is None or self.normal is None:
            return
        try:
            save_site(self._scene, self.centre_mm.tolist(), self.normal.tolist())
        except (InputError, OSError) as error:
            self._draw(f"not saved: {error}", UNSAVED)
        else:
            self._draw(f"saved into {self._scene}", SITE)
        self.plotter.render()

    def open(self) -> None:
        """Open the window; return after it was closed."""
        free_keys(self.plotter)
        on_click(self.plotter, self.click)
        self.plotter.show()

    def _draw(self, about: str, colour: str) -> None:
        """Show the mark, the arrow and the text about the site."""
        import pyvista

        if self.centre_mm is None or self.normal is None:
            self.text = "no site yet"
        else:
            size = self._size_mm
            arrow = pyvista.Arrow(
                self.centre_mm, self.normal, scale=ARROW * size, tip_radius=0.07, shaft_radius=0.025
            )
            parts = {"mark": pyvista.Sphere(MARK * size, self.centre_mm), "arrow": arrow}
            for name, mesh in parts.items():
                self.plotter.add_mesh(mesh, color=colour, name=name, reset_camera=False)
            centre = in_words(self.centre_mm)
            self.text = f"centre ({centre}) mm, normal ({in_words(self.normal, 3)}), LPS\n{about}"
        self._words.input = self.text

    def _aim(self) -> None:
        """Point the camera so that the site is visible and the head is up."""
        towards = EYE
        if self.normal is not None:
            aside = np.cross(self.normal, [0.0, 0.0, 1.0])
            # the normal points to the head or the feet, so no direction is perpendicular to both
            aside = aside if np.linalg.norm(aside) > 0.1 else np.array([1.0, 0.0, 0.0])
            towards = self.normal + ASIDE * aside / np.linalg.norm(aside)
        towards = towards / np.linalg.norm(towards)
        # the head cannot be up in a view along the head's direction; then the front of the patient
        # is up
        up = (0.0, 0.0, 1.0) if abs(towards[2]) < 0.95 else (0.0, -1.0, 0.0)
        self.plotter.view_vector(towards, viewup=up)
        self.plotter.camera.zoom(ZOOM)


def show_site(folder: Path, *, screenshot: Path | None = None) -> str:
    """Show an imported bone with its site in a window, or draw it into a PNG file.

    A text about the site is returned.
    """
    window = SiteWindow(folder, off_screen=screenshot is not None)
    if screenshot is not None:
        window.plotter.screenshot(str(screenshot))
    else:
        window.open()
    window.plotter.close()
    return window.text.replace("\n", "; ")


def _bone(folder: Path, anatomy: dict[str, object]) -> Surface:
    file = folder / str(anatomy.get("file", "bone.ply"))
    return read_surface(file, scale_mm=float(str(anatomy.get("scale_mm", 1.0))), cut_off=True)


if __name__ == "__main__":
    show_site(Path(sys.argv[1]), screenshot=Path(sys.argv[2]))
