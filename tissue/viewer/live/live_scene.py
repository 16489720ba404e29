"""A scene while it runs, in a plotter: tissue, tool, force and the mark of the device, from what the ticks share."""

import json
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from tissue.figures.faces import faces_of
from tissue.figures.style import layer_colours
from tissue.figures.tool_mesh import turning_tool
from tissue.scene.scene import Scene
from tissue.simulation.live.shared import SharedArrays
from tissue.viewer.camera import aim
from tissue.viewer.live.readings import Readings
from tissue.viewer.live.tissue_shown import live_tissue
from tissue.viewer.plotter import Plotter
from tissue.viewer.tool import ToolShown

__all__ = ["DEVICE", "LiveScene"]

TISSUE_S = 0.2
"""Least time between two updates of the tissue [s]; one that took long is followed by a rest as long as itself."""
DEVICE = "#D55E00"
LEAST_N = 1.0
"""Force that is drawn as the longest arrow until there is a greater one."""


class LiveScene:
    """Tissue, tool, force, and mark of the device with its spring.

    Parameters
    ----------
    folder
        Folder that `tissue.simulation.live.window.WindowProcess` has filled.
    size_px
        Width and height of the window [pixel].
    margins
        Left, right, lower and upper end of the area for the scene, in shares of the window.
    off_screen
        Whether there is no window, only pictures.

    Attributes
    ----------
    arrays
        What the ticks share.
    scene
        What is run.
    plotter
        PyVista's plotter.
    tissue
        What changes; None for a tissue that does not.
    colours
        Of what is shown by name, red, green and blue, 0 to 1.
    points_mm
        Points that have to be seen [mm], shape (n, 3).
    target_options
        What a `tissue.viewer.live.target.Target` is made of, by argument.
    """

    def __init__(
        self,
        folder: Path,
        *,
        size_px: tuple[int, int],
        margins: tuple[float, float, float, float],
        off_screen: bool = False,
    ) -> None:
        import pyvista

        self.arrays = SharedArrays(folder)
        with np.load(folder / "start.npz", allow_pickle=False) as file:
            start = dict(file)
        scene = self.scene = Scene.model_validate_json((folder / "scene.json").read_text("utf-8"))
        columns = json.loads((folder / "columns.json").read_text("utf-8"))
        self._places = {name: index for index, name in enumerate(columns)}
        self.plotter: Plotter = pyvista.Plotter(
            window_size=list(size_px), title=f"tissue: {scene.name}, live", off_screen=off_screen
        )
        self.plotter.background_color = pyvista.Color("white")
        self.tissue = live_tissue(self.plotter, start, self.arrays)
        faces = faces_of(scene)
        colours = layer_colours(tuple(faces))
        for name, face in faces.items():
            self.plotter.add_mesh(face, color=colours[name], opacity=0.6, show_edges=name == "wall", edge_color="white")
        self.colours = {**colours, **(self.tissue.colours if self.tissue is not None else {})}
        seen = [1e3 * start["start_m"][None], *(np.asarray(face.points) for face in faces.values())]
        if self.tissue is not None:
            seen.append(self.tissue.points_mm)
        self.points_mm: NDArray[np.float64] = np.vstack(seen)
        self._add_tool()
        aim(self.plotter, self.points_mm, margins=margins)
        self.target_options = {
            "start_mm": 1e3 * start["start_m"],
            "axis": start["axis"],
            "low_mm": 1e3 * start["low_m"],
            "high_mm": 1e3 * start["high_m"],
        }
        self._updated, self._took, self._greatest = 0.0, 0.0, LEAST_N

    def update_tissue(self) -> bool:
        """Bring the tissue up to date where that is time; whether it changed."""
        now = perf_counter()
        if self.tissue is None or now - self._updated <= max(TISSUE_S, 2.0 * self._took):
            return False
        changed = self.tissue.update()
        self._updated, self._took = now, perf_counter() - now
        return changed

    def show(self, target_mm: NDArray[np.float64]) -> Readings | None:
        """Show the newest row, and where the tool is wanted [mm]; what it holds, or None where there is none yet."""
        message = self.arrays.read("row")
        if message is None or message[0] == 0:
            return None
        readings = Readings.of(message[1], self._places)
        if not readings.turn.any():
            return None
        self._mark.position = tuple(target_mm)
        self._spring.points = np.stack([readings.tip_mm, target_mm])
        self._greatest = max(self._greatest, float(np.linalg.norm(readings.force_N)))
        self._tool.show(readings.tip_mm, readings.turn, readings.force_N, greatest_N=self._greatest)
        return readings

    def _add_tool(self) -> None:
        """The tool, the device's mark and the spring between them."""
        import pyvista

        size_mm = float(np.linalg.norm(np.ptp(self.points_mm, axis=0)))
        look = {"reset_camera": False, "render": False, "color": DEVICE}
        self._mark = self.plotter.add_mesh(pyvista.Sphere(radius=0.008 * size_mm), **look)
        self._spring = pyvista.Line((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
        self.plotter.add_mesh(self._spring, line_width=3, **look)
        tool = turning_tool(self.scene.tool)
        self._tool = ToolShown(self.plotter, tool, longest_mm=0.25 * size_mm, opacity=0.5)
