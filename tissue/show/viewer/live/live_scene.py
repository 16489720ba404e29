"""Scene of a live run in a plotter: tissue, tool, force and requested position."""

import json
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
from vtkmodules.vtkCommonDataModel import vtkPlane

from meshes.base.arrays import Array
from tissue.scene.scene import Scene
from tissue.show.figures.figure import layer_colours
from tissue.show.figures.tool_mesh import faces_of, turning_tool
from tissue.show.viewer.fields import layer_look
from tissue.show.viewer.plotter import Plotter, aim, new_plotter
from tissue.show.viewer.run_scene import ToolShown
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

TISSUE_S = 0.2
"""Shortest time between two updates of the tissue [s].

An update that takes longer is followed by a pause of the same length, in which the window draws and
responds to the mouse.
"""
DEVICE = "#D55E00"
LEAST_N = 1.0
"""Force that is drawn as the longest arrow until a larger force occurs [N].

Without this limit, the first contact with some millinewtons would have the longest arrow.
"""


NUMBERS = ("time_s", "removed_mm3", *CLOCK)
"""Names of columns whose values are shown without conversion."""


@dataclass(frozen=True)
class Readings:
    """Values of the newest row, which holds the trace columns and the clock columns.

    Attributes
    ----------
    tip_mm, turn
        Tip of the tool [mm] and its orientation (x, y, z, w).
    force_N, torque_Nm
        Force [N] and torque [N m] of the tissue on the tool, shape (3,) each.
    device_N
        Magnitude of the force that the device plays [N]; None if there is no device.
    layer
        Name of the layer with the largest contact area, such as ``dentin``.
    numbers
        Values of the columns `NUMBERS`, keyed by name.
    """

    tip_mm: Array
    turn: Array
    force_N: Array
    torque_Nm: Array
    device_N: float | None
    layer: str
    numbers: dict[str, float]

    @classmethod
    def of(cls, columns: tuple[str, ...], row: Array, start: Start) -> "Readings":
        """Read the values from a row that holds trace columns and clock columns."""
        table = Table(columns, row[None], tuple(map(str, start["layer_names"])))
        plays = "device_force_x_N" in table
        return cls(
            tip_mm=table.vectors("tool", "mm")[0],
            turn=table.quaternions()[0],
            force_N=table.vectors("model_force", "N")[0],
            torque_Nm=table.vectors("model_torque", "Nm")[0],
            device_N=float(np.linalg.norm(table.vectors("device_force", "N")[0]))
            if plays
            else None,
            layer=str(table["layer"][0]),
            numbers={name: float(table[name][0]) for name in NUMBERS},
        )


def read_start(folder: Path) -> tuple[Scene, Start]:
    """Read the scene and the initial data that the simulation process wrote to a folder."""
    with np.load(folder / "start.npz", allow_pickle=False) as file:
        start: Start = dict(file)
    return Scene.read_back((folder / "scene.json").read_text("utf-8")), start


PASSES = 4
"""Number of passes that smooth the normals.

A still picture uses more passes. A live run needs a small number, because each change of the bone
requires new normals.
"""
AROUND = 0.7
"""Margin that is shown around the touchable surface, relative to its size."""
ORGAN = "#CC8E7D"


class LiveScene:
    """Drawn objects of a live run: tissue, tool, force, coupling spring and requested position.

    Parameters
    ----------
    folder
        Folder that `tissue.simulation.live.window.WindowProcess` has filled.
    size_px
        Width and height of the window [pixels].
    margins
        Left, right, lower and upper edge of the scene's area, as fractions of the window.
    off_screen
        If true, pictures are drawn without a window.

    Attributes
    ----------
    arrays
        Arrays that are shared with the process that computes the ticks.
    scene
        Scene of the run.
    plotter
        PyVista's plotter.
    is_bone
        True for a scene with bone, which can be cut open.
    is_cut_open
        True if the bone between the camera and the tool is left out.
    colours
        Colours of the layers of the bone and of faces (red, green and blue, 0 to 1), keyed by name.
    points_mm
        Points that must be in view [mm], shape (n, 3).
    target_options
        Arguments of `tissue.show.viewer.live.live_scene.Target`, keyed by name.
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
        self.scene, start = read_start(folder)
        self._start = start
        self._columns = tuple(json.loads((folder / "columns.json").read_text("utf-8")))
        title = f"tissue: {self.scene.name}, live"
        self.plotter = new_plotter(size_px, title=title, off_screen=off_screen)
        self.target_options = {
            "start_mm": 1e3 * start["start_m"],
            "axis": start["axis"],
            "low_mm": 1e3 * start["low_m"],
            "high_mm": 1e3 * start["high_m"],
        }
        self._tissue = tissue_surface(start, self.arrays)
        self.is_bone = isinstance(self._tissue, BoneSurface)
        self.is_cut_open = False
        self._cut = vtkPlane()
        self._updated = self._took = 0.0
        self._largest = LEAST_N
        faces = faces_of(self.scene)
        self.colours = layer_colours(tuple(faces))
        seen = [self.target_options["start_mm"][None], *(face.points for face in faces.values())]
        match self._tissue:
            case BoneSurface() as bone:
                volume = bone.volume
                there = np.unique(volume.layer[volume.fraction > 0])
                colours = layer_colours(volume.layer_names)
                self.colours |= {
                    volume.layer_names[i]: colours[volume.layer_names[i]] for i in there
                }
                self._draw_bone(bone)
                seen.append(bone.surface.points)
            case OrganSurface() as organ:
                add_organ(self.plotter, organ)
                patch = organ.touchable_mm
                seen.append(patch + AROUND * (patch - patch.mean(axis=0)))
        self.points_mm: Array = np.vstack(seen)
        for name, face in faces.items():
            self.plotter.add_mesh(
                face,
                color=self.colours[name],
                opacity=0.6,
                # a wall has no shape of its own; its squares show where it is
                show_edges=name == "wall",
                edge_color="white",
            )
        self._add_tool()
        aim(self.plotter, self.points_mm, margins=margins)
        self._place_cut(self.target_options["start_mm"])

    def cut_open(self, is_open: bool) -> None:
        """Hide the bone between camera and tool if ``is_open`` is True; show it otherwise."""
        if isinstance(self._tissue, BoneSurface) and is_open != self.is_cut_open:
            self.is_cut_open = is_open
            self._draw_bone(self._tissue)

    def update_tissue(self) -> bool:
        """Update the tissue if an update is due; return whether the tissue changed."""
        now = perf_counter()
        # an update takes at most half of the time, so that the tool still moves smoothly
        if self._tissue is None or now - self._updated <= max(TISSUE_S, 2.0 * self._took):
            return False
        changed = self._tissue.update()
        if changed and isinstance(self._tissue, BoneSurface):
            self._draw_bone(self._tissue)
        self._updated = now
        self._took = perf_counter() - now
        return changed

    def show(self, target_mm: Array) -> Readings | None:
        """Show the newest row of the trace and the requested position of the tool [mm].

        The values of the row are returned. The result is None if there is no row yet.
        """
        message = self.arrays.read("row")
        if message is None or message[0] == 0:
            return None
        readings = Readings.of(self._columns, message[1], self._start)
        # a quaternion of zeros: the row has not been written yet
        if not readings.turn.any():
            return None
        self._mark.position = tuple(target_mm)
        if self.is_cut_open:
            self._place_cut(readings.tip_mm)
        self._spring.points = np.stack([readings.tip_mm, target_mm])
        self._largest = max(self._largest, float(np.linalg.norm(readings.force_N)))
        self._tool.show(readings.tip_mm, readings.turn, readings.force_N, largest_N=self._largest)
        return readings

    def _draw_bone(self, bone: BoneSurface) -> None:
        """Draw the bone again, coloured by layer."""
        surface = bone.surface
        # all bone is removed: the last surface must not stay in view
        if not surface.n_cells:
            self.plotter.remove_actor("bone", render=False)
            return
        with_layers(surface, bone.volume)
        surface.point_data["Normals"] = smooth_normals(surface, passes=PASSES)
        look = layer_look(bone.volume.layer_names)
        actor = self.plotter.add_mesh(surface, name="bone", **look)
        if self.is_cut_open:
            actor.mapper.AddClippingPlane(self._cut)

    def _place_cut(self, tip_mm: Array) -> None:
        """Place the cut through the tip and along the axis of the tool, facing the camera."""
        axis = self.target_options["axis"]
        forward = np.array(self.plotter.camera.GetDirectionOfProjection())
        across = forward - (forward @ axis) * axis
        # A camera that looks nearly along the tool (within 6 degrees) has no such plane.
        size = float(np.linalg.norm(across))
        normal = across / size if size > 0.1 else forward
        self._cut.SetOrigin(*tip_mm)
        self._cut.SetNormal(*normal)

    def _add_tool(self) -> None:
        """Add the tool, a mark at the requested position, and the spring between them."""
        import pyvista

        size_mm = float(np.linalg.norm(np.ptp(self.points_mm, axis=0)))
        look = {"reset_camera": False, "render": False, "color": DEVICE}
        # a mark of 1.6 % and an arrow of a quarter of the scene's size
        self._mark = self.plotter.add_mesh(pyvista.Sphere(radius=0.008 * size_mm), **look)
        self._spring = pyvista.Line((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
        self.plotter.add_mesh(self._spring, line_width=3, **look)
        tool = turning_tool(self.scene.tool)
        # the tissue behind the tool stays visible
        self._tool = ToolShown(self.plotter, tool, longest_mm=0.25 * size_mm, opacity=0.5)


def add_organ(plotter: Plotter, organ: OrganSurface) -> None:
    """Draw the surface of a soft organ; each update moves its points."""
    plotter.add_mesh(
        organ.surface,
        color=ORGAN,
        smooth_shading=True,
        show_edges=True,
        edge_color="#B07365",
        line_width=0.5,
        specular=0.2,
        reset_camera=False,
    )


NOTCH_MM = 0.5
KEY_MM = 0.5
"""Travel per notch of the mouse wheel or key press [mm]: a fraction of a small burr's diameter."""
KEYS = {
    "Left": (-1.0, 0.0, 0.0),
    "Right": (1.0, 0.0, 0.0),
    "Up": (0.0, 1.0, 0.0),
    "Down": (0.0, -1.0, 0.0),
    "s": (0.0, 0.0, -1.0),
    "w": (0.0, 0.0, 1.0),
}
"""Direction of each key: right and up in the view, and outward along the tool."""
SAME_KEYS = {"Next": "s", "PageDown": "s", "Prior": "w", "PageUp": "w"}
"""Other names of keys in `KEYS`, in VTK and in browsers."""


class Target:
    """Requested position of a tool within a box.

    Parameters
    ----------
    plotter
        Plotter of the view.
    start_mm
        Initial position [mm].
    axis
        Axis of the tool from tip to shank, shape (3,).
    low_mm, high_mm
        Corners of the box that the position may not leave [mm].

    Attributes
    ----------
    target_mm
        Requested position of the tool [mm], shape (3,).
    """

    def __init__(
        self, plotter: Plotter, start_mm: Array, axis: Array, *, low_mm: Array, high_mm: Array
    ) -> None:
        self._plotter = plotter
        self._axis = axis
        self._low = low_mm
        self._high = high_mm
        self._start: Array = np.array(start_mm, dtype=float)
        self.target_mm = self._start.copy()

    def reset(self) -> None:
        """Move the requested position back to the initial position."""
        self.target_mm = self._start.copy()

    def along(self, travel_mm: float) -> None:
        """Move the position along the tool's axis by a distance [mm], positive outward."""
        self._go(travel_mm * self._axis)

    def across(self, right_mm: float, up_mm: float) -> None:
        """Move the position by distances [mm] to the right and upward in the view."""
        camera = self._plotter.camera
        forward = np.array(camera.GetDirectionOfProjection())
        right = np.cross(forward, camera.GetViewUp())
        right /= np.linalg.norm(right)
        self._go(right_mm * right + up_mm * np.cross(right, forward))

    def press(self, key: str) -> None:
        """Move the position by `KEY_MM` in the direction of a key.

        The key is given by its name in VTK or in a browser. Keys without a direction are ignored.
        """
        key = SAME_KEYS.get(key, key).removeprefix("Arrow")
        right, up, outward = KEY_MM * np.array(KEYS.get(key, (0.0, 0.0, 0.0)))
        self.across(right, up)
        self.along(outward)

    @property
    def mm_per_pixel(self) -> float:
        """Size of a pixel at the distance of the requested position from the camera [mm]."""
        camera = self._plotter.camera
        away = float(
            (self.target_mm - camera.GetPosition()) @ np.array(camera.GetDirectionOfProjection())
        )
        tall = self._plotter.window_size[1]
        # a target at or behind the eye has no size; 1 mm keeps the mouse usable
        return 2.0 * max(away, 1.0) * float(np.tan(np.radians(0.5 * camera.GetViewAngle()))) / tall

    def _go(self, travel_mm: Array) -> None:
        self.target_mm = np.clip(self.target_mm + travel_mm, self._low, self._high)


HELP = (
    "mouse or arrows: move in the view's plane",
    "wheel, page down/up or s/w: deeper, higher",
    "drag: turn the view, right drag: nearer, farther",
    "q: end",
)
"""Description of keys and mouse actions."""


class Pointer(Target):
    """Requested position of a tool within a box, moved with mouse and keys.

    The position follows the mouse in the plane that contains the position and is parallel to the
    view. While a mouse button is pressed, the mouse changes the view instead. The wheel and the
    depth keys move the position along the tool's axis.

    Parameters
    ----------
    plotter
        Plotter of the window.
    **options
        Other arguments of `Target`.

    Attributes
    ----------
    target_mm
        Requested position of the tool [mm], shape (3,).
    ended
        True if the user pressed the key that ends the run.
    """

    def __init__(self, plotter: Plotter, **options: Array) -> None:
        super().__init__(plotter, **options)
        self.ended = False
        self._at: tuple[int, int] | None = None
        interactor = self._interactor = plotter.iren.interactor
        self._style = style = interactor.GetInteractorStyle()
        interactor.AddObserver("MouseMoveEvent", self._moved)
        interactor.AddObserver("LeaveEvent", self._left)
        interactor.AddObserver("KeyPressEvent", self._pressed)
        # If an observer is added for an event of the style, the style no longer handles the event.
        # Zoom and shortcuts are thus switched off.
        style.AddObserver("MouseWheelForwardEvent", lambda *_: self.along(-NOTCH_MM))
        style.AddObserver("MouseWheelBackwardEvent", lambda *_: self.along(NOTCH_MM))
        style.AddObserver("CharEvent", lambda *_: None)

    def _moved(self, *_: object) -> None:
        before = self._at
        self._at = self._interactor.GetEventPosition()
        # a pressed button turns the view instead
        if before is None or self._style.GetState() != 0:
            return
        pixel = self.mm_per_pixel
        self.across(pixel * (self._at[0] - before[0]), pixel * (self._at[1] - before[1]))

    def _left(self, *_: object) -> None:
        self._at = None

    def _pressed(self, *_: object) -> None:
        key = self._interactor.GetKeySym()
        if key in ("q", "Escape"):
            self.ended = True
        else:
            self.press(key)
