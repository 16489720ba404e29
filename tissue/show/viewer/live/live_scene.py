"""A scene while it runs, in a plotter: tissue, tool, force and the mark of the device."""

import json
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from tissue.scene.scene import Scene
from tissue.show.figures.faces import faces_of
from tissue.show.figures.figure import layer_colours
from tissue.show.figures.tool_mesh import tool_turns, turning_tool
from tissue.show.viewer.bone import layer_look
from tissue.show.viewer.moment import ToolShown
from tissue.show.viewer.plotter import Plotter, aim, new_plotter
from tissue.simulation.bone_surface import smooth_normals, with_layers
from tissue.simulation.live.shared import (
    BoneSurface,
    OrganSurface,
    SharedArrays,
    Start,
    tissue_surface,
)
from tissue.simulation.live.window import CLOCK
from tissue.simulation.trace import Table

__all__ = ["DEVICE", "LiveBone", "LiveOrgan", "LiveScene", "Readings", "live_tissue"]

TISSUE_S = 0.2
"""Minimum time between two updates of the tissue [s].

A longer update is followed by a pause of the same length.
"""
DEVICE = "#D55E00"
LEAST_N = 1.0
"""Force that is drawn as the longest arrow until there is a greater one."""


Array = NDArray[np.float64]
NUMBERS = ("time_s", "removed_mm3", *CLOCK)
"""Columns that are shown without conversion."""


@dataclass(frozen=True)
class Readings:
    """The newest row of the trace and of the clock.

    Attributes
    ----------
    tip_mm, turn
        Tip of the tool [mm] and its orientation (x, y, z, w).
    force_N, torque_Nm
        Load of the tissue on the tool [N], [N m], shape (3,) each.
    device_N
        Size of the force that the device displays [N], None without a device.
    numbers
        The columns of `NUMBERS` by name.
    """

    tip_mm: Array
    turn: Array
    force_N: Array
    torque_Nm: Array
    device_N: float | None
    numbers: dict[str, float]

    @classmethod
    def of(cls, table: Table) -> "Readings":
        """Read the first row of a table with the columns of the trace and of the clock."""
        plays = "device_force_x_N" in table
        return cls(
            tip_mm=table.vectors("tool", "mm")[0],
            turn=tool_turns(table)[0],
            force_N=table.vectors("model_force", "N")[0],
            torque_Nm=table.vectors("model_torque", "Nm")[0],
            device_N=float(np.linalg.norm(table.vectors("device_force", "N")[0]))
            if plays
            else None,
            numbers={name: float(table[name][0]) for name in NUMBERS},
        )


PASSES = 4
"""Smoothing of normals: fewer than in a picture, for it is done again at every change."""
AROUND = 0.7
"""Margin shown around the touchable surface, as a share of its size."""
ORGAN = "#CC8E7D"


def live_tissue(
    plotter: Plotter, start: Start, arrays: SharedArrays
) -> "LiveBone | LiveOrgan | None":
    """Return the drawn tissue that `tissue.simulation.live` shares.

    The result is None if only the scene describes the tissue.
    """
    match tissue_surface(start, arrays):
        case BoneSurface() as bone:
            return LiveBone(plotter, bone)
        case OrganSurface() as organ:
            return LiveOrgan(plotter, organ)
    return None


class LiveBone:
    """Bone by layer while it is carved.

    Parameters
    ----------
    plotter
        Plotter of the bone.
    bone
        Surface of the bone.

    Attributes
    ----------
    points_mm
        Points that must be in view [mm], shape (n, 3).
    colours
        Colours of the existing layers by name, red, green and blue, 0 to 1.
    """

    def __init__(self, plotter: Plotter, bone: BoneSurface) -> None:
        self._plotter = plotter
        self._bone = bone
        names = bone.volume.layer_names
        colours = layer_colours(names)
        self._look = layer_look(names)
        there = [names[i] for i in np.unique(bone.volume.layer[bone.volume.fraction > 0])]
        self.colours = {name: colours[name] for name in there}
        self._draw()
        self.points_mm: Array = np.asarray(bone.surface.points, dtype=np.float64)

    def update(self) -> bool:
        """Draw the bone again if a brick has lost something."""
        changed = self._bone.update()
        if changed:
            self._draw()
        return changed

    def _draw(self) -> None:
        surface = self._bone.surface
        if not surface.n_cells:
            self._plotter.remove_actor("bone", render=False)
            return
        with_layers(surface, self._bone.volume)
        surface.point_data["Normals"] = smooth_normals(surface, passes=PASSES)
        self._plotter.add_mesh(surface, name="bone", **self._look)


class LiveOrgan:
    """Surface of a soft organ while it moves.

    Parameters
    ----------
    plotter
        Plotter of the organ.
    organ
        Surface of the organ.

    Attributes
    ----------
    points_mm
        Points that must be in view [mm], shape (n, 3).
    colours
        Empty, since the organ has only one colour.
    """

    def __init__(self, plotter: Plotter, organ: OrganSurface) -> None:
        self.colours: dict[str, tuple[float, float, float]] = {}
        self._organ = organ
        self._actor = plotter.add_mesh(
            organ.surface,
            color=ORGAN,
            smooth_shading=True,
            show_edges=True,
            edge_color="#B07365",
            line_width=0.5,
            specular=0.2,
            reset_camera=False,
        )
        patch = organ.touchable_mm
        self.points_mm: Array = patch + AROUND * (patch - patch.mean(axis=0))

    def update(self) -> bool:
        """Draw the surface where it has moved to."""
        return self._organ.update()


class LiveScene:
    """Tissue, tool, force, and mark of the device with its spring.

    Parameters
    ----------
    folder
        Folder filled by `tissue.simulation.live.window.WindowProcess`.
    size_px
        Width and height of the window [pixel].
    margins
        Left, right, lower and upper end of the area for the scene, in shares of the window.
    off_screen
        If true, pictures are drawn without a window.

    Attributes
    ----------
    arrays
        Arrays shared by the ticks.
    scene
        Scene of the run.
    plotter
        PyVista's plotter.
    tissue
        Drawn tissue that changes. None for a tissue without changes.
    colours
        Colours of the shown objects by name, red, green and blue, 0 to 1.
    points_mm
        Points that must be in view [mm], shape (n, 3).
    target_options
        Arguments of a `tissue.show.viewer.live.target.Target`, by name.
    """

    def __init__(
        self,
        folder: Path,
        *,
        size_px: tuple[int, int],
        margins: tuple[float, float, float, float],
        off_screen: bool = False,
    ) -> None:

        self.arrays = SharedArrays(folder)
        with np.load(folder / "start.npz", allow_pickle=False) as file:
            start = dict(file)
        scene = self.scene = Scene.read_back((folder / "scene.json").read_text("utf-8"))
        self._columns = tuple(json.loads((folder / "columns.json").read_text("utf-8")))
        self.plotter = new_plotter(
            size_px, title=f"tissue: {scene.name}, live", off_screen=off_screen
        )
        self.tissue = live_tissue(self.plotter, start, self.arrays)
        faces = faces_of(scene)
        colours = layer_colours(tuple(faces))
        for name, face in faces.items():
            self.plotter.add_mesh(
                face,
                color=colours[name],
                opacity=0.6,
                show_edges=name == "wall",
                edge_color="white",
            )
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
        self._updated = 0.0
        self._took = 0.0
        self._greatest = LEAST_N

    def update_tissue(self) -> bool:
        """Update the tissue if it is due; return whether it changed."""
        now = perf_counter()
        if self.tissue is None or now - self._updated <= max(TISSUE_S, 2.0 * self._took):
            return False
        changed = self.tissue.update()
        self._updated = now
        self._took = perf_counter() - now
        return changed

    def show(self, target_mm: NDArray[np.float64]) -> Readings | None:
        """Show the newest row and the wanted position of the tool [mm]; return the row's readings.

        The result is None if there is no row yet.
        """
        message = self.arrays.read("row")
        if message is None or message[0] == 0:
            return None
        readings = Readings.of(Table(self._columns, message[1][None]))
        if not readings.turn.any():
            return None
        self._mark.position = tuple(target_mm)
        self._spring.points = np.stack([readings.tip_mm, target_mm])
        self._greatest = max(self._greatest, float(np.linalg.norm(readings.force_N)))
        self._tool.show(readings.tip_mm, readings.turn, readings.force_N, greatest_N=self._greatest)
        return readings

    def _add_tool(self) -> None:
        """Add the tool, the device's mark and the spring between them."""
        import pyvista

        size_mm = float(np.linalg.norm(np.ptp(self.points_mm, axis=0)))
        look = {"reset_camera": False, "render": False, "color": DEVICE}
        self._mark = self.plotter.add_mesh(pyvista.Sphere(radius=0.008 * size_mm), **look)
        self._spring = pyvista.Line((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
        self.plotter.add_mesh(self._spring, line_width=3, **look)
        tool = turning_tool(self.scene.tool)
        self._tool = ToolShown(self.plotter, tool, longest_mm=0.25 * size_mm, opacity=0.5)
