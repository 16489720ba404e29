"""The tool in a live window: where it is, where the device wants it, its force, and how the clock is kept."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue.viewer.plotter import Plotter
from tissue.viewer.tool import ToolShown

if TYPE_CHECKING:
    import pyvista

__all__ = ["LiveTool"]

DEVICE = "#D55E00"
LEAST_N = 1.0
"""Force that is drawn as the longest arrow until there is a greater one."""


class LiveTool:
    """Tool, mark of the device, force and words of the newest row.

    Parameters
    ----------
    plotter
        Where they are shown.
    tool
        Surface of the tool in its own frame [mm], or None.
    columns
        Names of the values of a row: those of the trace, then `tissue.simulation.live.window.CLOCK`.
    size_mm
        Size of what is seen [mm].
    """

    def __init__(
        self, plotter: Plotter, tool: "pyvista.PolyData | None", columns: tuple[str, ...], *, size_mm: float
    ) -> None:
        import pyvista

        self._at = {name: index for index, name in enumerate(columns)}
        look = {"reset_camera": False, "render": False}
        mark = pyvista.Sphere(radius=0.008 * size_mm)
        self._mark = plotter.add_mesh(mark, color=DEVICE, **look)
        self._spring_mesh = pyvista.Line((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
        self._spring = plotter.add_mesh(self._spring_mesh, color=DEVICE, line_width=3, **look)
        self._tool = ToolShown(plotter, tool, longest_mm=0.25 * size_mm, opacity=0.5)
        self._greatest = LEAST_N
        self._words = plotter.add_text("", position=(0.012, 0.93), viewport=True, font_size=11, color="black")
        self._clock = plotter.add_text("", position=(0.012, 0.895), viewport=True, font_size=9, color="black")

    def show(self, row: NDArray[np.float64], target_mm: NDArray[np.float64]) -> None:
        """Show a row, and where the pointer wants the tool [mm]."""
        of = lambda *names: row[[self._at[name] for name in names]]  # noqa: E731
        tip, turn = of(*(f"tool_{c}_mm" for c in "xyz")), of(*(f"tool_q{c}" for c in "xyzw"))
        if not turn.any():
            return
        self._mark.position = tuple(target_mm)
        self._spring_mesh.points = np.stack([tip, target_mm])
        force = of(*(f"model_force_{c}_N" for c in "xyz"))
        self._greatest = max(self._greatest, float(np.linalg.norm(force)))
        shown = self._tool.show(tip, turn, force, greatest_N=self._greatest)
        words = [f"{of('time_s')[0]:.2f} s: {shown}"]
        if "device_force_x_N" in self._at:
            played = float(np.linalg.norm(of(*(f"device_force_{c}_N" for c in "xyz"))))
            words.append(f"at the device {played:.2f} N")
        removed = float(of("removed_mm3")[0])
        if removed > 0.0:
            words.append(f"removed {removed:.2f} mm³")
        self._words.input = ", ".join(words)
        took, late, missed, skipped = of("tick_us", "late_us", "missed", "skipped_ms")
        clock = f"tick {took:.0f} µs, {late:.0f} µs late; {missed:.0f} deadlines of 1 ms missed"
        self._clock.input = f"{clock}, {skipped:.0f} ms skipped" if skipped > 0.0 else clock
