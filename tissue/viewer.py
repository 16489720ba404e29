"""The scene in the window of `tissue view`."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from meshes.errors import InputError
from meshes.volume import VoxelVolume
from tissue.pictures import COMPONENTS
from tissue.run_folder import SavedRun
from tissue.scene import Scene
from tissue.surface import bone_surface, with_layers
from tissue.trace import Table
from tissue.viewer_bone import BoneShown, read_voxels
from tissue.viewer_fields import FieldsShown, field_names

if TYPE_CHECKING:
    import pyvista

__all__ = ["scene_of", "show"]

SIZE = (1400, 950)
COARSE_MM = 0.4
"""Spacing at which the starting bone of an incomplete run is built again."""
CHART_SHARE = 0.27
MOST_POINTS = 4000
"""Rows of the trace that a path or a curve shows."""


def scene_of(saved: SavedRun) -> Scene | None:
    """The scene of a run, if its file is there and whole."""
    from tissue.load import load_scene

    try:
        return load_scene(saved.path / "scene.toml")
    except (InputError, OSError, ValueError):
        return None


def show(
    saved: SavedRun, title: str, screenshot: Path | None = None, *, hide: tuple[str, ...] = (), field: str | None = None
) -> None:
    """Open the window, or draw it off screen into a file.

    Parameters
    ----------
    saved
        The run.
    title
        What is written above.
    screenshot
        PNG file.
    hide
        Layers that are off at first.
    field
        Field that is shown at first in place of the bone.
    """
    import pyvista

    plotter: Any = pyvista.Plotter(
        off_screen=screenshot is not None, window_size=list(SIZE), title=f"tissue: {saved.summary.get('scene', 'run')}"
    )
    plotter.set_background("white")
    surface, voxels = _bone(saved)
    bone = None if surface is None else BoneShown(plotter, surface, voxels)
    fields = _fields(plotter, saved)
    keys = bone.help if bone is not None else []

    def change() -> None:
        shown = fields.next() if fields is not None else None
        if bone is not None:
            bone.show(shown is None)
        plotter.render()

    if fields is not None:
        keys = [*keys, "m: stress, then the next field"]
        plotter.add_key_event("m", change)
    lines = [title, "    ".join(keys), "drag the slider for the time    q: close"]
    plotter.add_text("\n".join(line for line in lines if line), position="upper_left", font_size=9, color="black")
    if bone is not None and hide:
        bone.toggle(*hide)
    if saved.trace is not None and len(saved.trace.rows):
        _Moment(plotter, saved, saved.trace, surface, fields)
    if fields is not None and field is not None:
        fields.show(field)
        if bone is not None:
            bone.show(False)
    _aim(plotter)
    if screenshot is None:
        _free_digits(plotter)
        plotter.show()
    else:
        plotter.screenshot(str(screenshot))
    plotter.close()


def _fields(plotter: Any, saved: SavedRun) -> FieldsShown | None:
    """The fields of a run, cut open where the tool was deepest."""
    if not field_names(saved.path):
        return None
    cut = 0.0
    if saved.trace is not None and len(saved.trace.rows):
        cut = float(saved.trace["tool_y_mm"][saved.trace["tool_z_mm"].argmin()])
    return FieldsShown(plotter, saved.path, cut_mm=cut)


def _free_digits(plotter: Any) -> None:
    """Keep VTK from taking the key 3 for a stereo picture."""
    style = plotter.iren.interactor.GetInteractorStyle()

    def typed(caller: Any, event: str) -> None:
        if not plotter.iren.interactor.GetKeyCode().isdigit():
            style.OnChar()

    style.AddObserver("CharEvent", typed)


def _bone(saved: SavedRun) -> "tuple[pyvista.PolyData | None, VoxelVolume | None]":
    """The carved bone, surface and voxels; of an incomplete run the bone it started from, coarse; None without."""
    import pyvista

    file = saved.path / "bone.vtp"
    if saved.complete and file.is_file():
        surface: Any = pyvista.read(file)
        return (surface, read_voxels(saved.path / "bone.vti")) if surface.n_cells else (None, None)
    scene = scene_of(saved)
    if scene is None or scene.anatomy.file is not None:
        return None, None
    from tissue.anatomies import volume_of
    from tissue.build import cutter_of, motion_of

    spacing = max(COARSE_MM, scene.voxels.spacing_mm)
    coarse = scene.model_copy(update={"voxels": scene.voxels.model_copy(update={"spacing_mm": spacing})})
    try:
        volume = volume_of(
            coarse, cutter_of(scene.tool), motion_of(scene, step_s=1e-3), notes={}, tell=lambda doing, share: None
        )
    except InputError:
        return None, None
    return with_layers(bone_surface(volume, volume.fraction), volume), volume


class _Moment:
    """The tool, its force and the cursor in the chart at the time that the slider gives."""

    def __init__(
        self, plotter: Any, saved: SavedRun, trace: Table, bone: "pyvista.PolyData | None", fields: FieldsShown | None
    ) -> None:
        import pyvista

        self._fields = fields
        self._plotter, self._trace = plotter, trace
        self._tips, self._force = trace.vectors("tool", "mm"), trace.vectors("force", "N")
        self._turns = np.column_stack([trace[f"tool_q{c}"] for c in "xyzw"])
        every = slice(None, None, max(len(trace.rows) // MOST_POINTS, 1))
        path = self._tips[every]
        if len(path) > 1 and np.ptp(path, axis=0).max() > 0.0:
            plotter.add_mesh(pyvista.lines_from_points(path), color="#D55E00", line_width=3, show_scalar_bar=False)
        tool = _tool(saved)
        self._tool = None if tool is None else plotter.add_mesh(tool, color="gray", opacity=0.35, specular=0.4)
        self._greatest = float(np.linalg.norm(self._force, axis=1).max())
        sizes = [np.ptp(path, axis=0).max(), bone.length if bone is not None else 0.0, tool.length if tool else 0.0]
        self._longest = 0.4 * max(*map(float, sizes), 1.0)
        self._arrow_actor = plotter.add_mesh(pyvista.Arrow(), color="#0072B2")
        self._text = plotter.add_text("", position=(0.003, 0.925), viewport=True, font_size=8, color="black")
        time = trace["time_s"]
        self._chart, self._cursor = _chart(plotter, time[every], self._force[every])
        begin = int(np.linalg.norm(self._force, axis=1).argmax())
        self.at(float(time[begin]))
        if len(time) > 1:
            plotter.add_slider_widget(
                self.at,
                (float(time[0]), float(time[-1])),
                value=float(time[begin]),
                fmt="%.3f s",
                pointa=(0.03, CHART_SHARE + 0.04),
                pointb=(0.97, CHART_SHARE + 0.04),
                color="black",
                title_height=0.018,
                slider_width=0.012,
                tube_width=0.003,
                interaction_event="always",
            )

    def at(self, time_s: float) -> None:
        """Show the moment."""
        import pyvista
        from scipy.spatial.transform import Rotation

        trace = self._trace
        row = int(np.clip(np.searchsorted(trace["time_s"], time_s - 1e-9), 0, len(trace.rows) - 1))
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = Rotation.from_quat(self._turns[row]).as_matrix(), self._tips[row]
        if self._tool is not None:
            self._tool.user_matrix = pose
        force = self._force[row]
        size = float(np.linalg.norm(force))
        shown = size > 1e-3 * max(self._greatest, 1e-9)
        self._arrow_actor.SetVisibility(shown)
        if shown:
            length = self._longest * size / self._greatest
            self._arrow_actor.mapper.dataset = pyvista.Arrow(
                start=self._tips[row],
                direction=force,
                scale=length,
                shaft_radius=0.02 * self._longest / length,
                tip_radius=0.05 * self._longest / length,
                tip_length=min(0.12 * self._longest / length, 0.6),
            )
        self._text.input = (
            f"{time_s:.3f} s: force {size:.2f} N ({force[0]:.2f}, {force[1]:.2f}, {force[2]:.2f}), "
            f"{trace['layer'][row]}, removed {trace['removed_mm3'][row]:.2f} mm³"
        )
        self._cursor.update([time_s, time_s], self._chart.y_range)
        if self._fields is not None:
            self._fields.at(time_s)


def _tool(saved: SavedRun) -> "pyvista.PolyData | None":
    """The cutter's surface in its own frame [mm]: its half section turned around the axis."""
    import pyvista

    from tissue.build import cutter_of

    scene = scene_of(saved)
    if scene is None:
        return None
    outline = 1e3 * cutter_of(scene.tool).profile.outline
    line = pyvista.lines_from_points(np.column_stack([outline[:, 0], np.zeros(len(outline)), outline[:, 1]]))
    turned: pyvista.PolyData = line.extrude_rotate(resolution=72, capping=False)
    return turned


def _chart(plotter: Any, time: NDArray[np.float64], force: NDArray[np.float64]) -> tuple[Any, Any]:
    """The force over time along the lower edge, with a cursor."""
    import pyvista

    chart = pyvista.Chart2D(size=(0.98, CHART_SHARE), loc=(0.01, 0.0), x_label="time / s", y_label="force / N")
    size = np.linalg.norm(force, axis=1)
    chart.line(time, size, color="black", width=2.5, label="magnitude")
    for c, colour in enumerate(COMPONENTS):
        chart.line(time, force[:, c], color=colour, width=1.5, label="xyz"[c])
    low, high = float(min(force.min(), 0.0)), float(max(size.max(), 1e-3))
    chart.y_range = (low - 0.05 * (high - low), high + 0.05 * (high - low))
    chart.x_range = (float(time[0]), float(max(time[-1], time[0] + 1e-3)))
    cursor = chart.line([time[0], time[0]], list(chart.y_range), color=(0.4, 0.4, 0.4), width=1.5)
    chart.GetLegend().SetHorizontalAlignment(0)  # left, where a force has not risen yet
    plotter.add_chart(chart)
    return chart, cursor


def _aim(plotter: Any) -> None:
    """Look down on the face from the front, with the bone above the chart."""
    plotter.camera_position = [(0.25, -0.75, 0.8), (0.0, 0.0, 0.0), (0.0, 0.35, 1.0)]
    plotter.reset_camera()
    plotter.camera.zoom(0.88)
    plotter.camera.SetWindowCenter(0.0, -0.3)
