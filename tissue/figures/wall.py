"""A ball on a stiff wall, from the side: where the device went, where the ball stayed, and the force between."""

from pathlib import Path

import numpy as np

from tissue.figures.figure import figure, save
from tissue.scene.coupling import WallAnatomy
from tissue.scene.tool import Probe
from tissue.simulation.run import Run

__all__ = ["draw_wall"]

WALL, BALL, DEVICE, FORCE = "#CC79A7", "0.1", "#D55E00", "#0072B2"
LONGEST = 0.28
"""Length of the arrow of the greatest force, in shares of the picture's height."""


def draw_wall(run: Run, path: Path) -> None:
    """Draw the paths of ball and device across the wall and into it, and below the force over the device's depth.

    The ball is drawn at its deepest. In a run without a device the force is drawn over the ball's own depth.
    """
    trace, tool, wall = run.trace, run.scene.tool, run.scene.anatomy
    assert isinstance(tool, Probe) and isinstance(wall, WallAnatomy), wall.kind
    radius = 0.5 * tool.size_mm
    tips = trace.vectors("tool", "mm")
    device = trace.vectors("device", "mm") if "device_x_mm" in trace else None
    if device is not None:
        device = tips[0] + run.scene.motion_scale * (device - tips[0])
    force = trace["model_force_z_N"]
    across = int(np.ptp(tips[:, :2], axis=0).argmax())
    chart = figure(8.0, 6.6)
    side, felt = chart.subplots(2, 1, height_ratios=(1.5, 1.0))
    chart.subplots_adjust(left=0.1, right=0.98, top=0.92, bottom=0.09, hspace=0.3)
    side.axhspan(-1e3, 0.0, color=WALL, alpha=0.35, linewidth=0.0, label="wall")
    side.axhline(0.0, color=WALL, linewidth=1.4)
    if device is not None:
        side.plot(device[:, across], device[:, 2], color=DEVICE, linewidth=1.0, linestyle=(0, (4, 2)), label="device")
    side.plot(tips[:, across], tips[:, 2], color=BALL, linewidth=1.6, label="ball's tip")
    row = int(force.argmax())
    at = tips[row, across]
    angle = np.linspace(0.0, 2.0 * np.pi, 90)
    side.plot(at + radius * np.sin(angle), tips[row, 2] + radius * (1.0 - np.cos(angle)), color=BALL, linewidth=1.0)
    lowest = min(tips[:, 2].min(), 0.0 if device is None else device[:, 2].min())
    low, high = min(1.3 * lowest, -1.0), max(tips[:, 2].max(), 2.2 * radius)
    if force[row] > 0.0:
        arrow = {"arrowstyle": "-|>", "color": FORCE, "linewidth": 2.0, "shrinkA": 0, "shrinkB": 0}
        end = tips[row, 2] + LONGEST * (high - low)
        side.annotate("", (at, end), (at, tips[row, 2]), arrowprops=arrow)
        side.annotate(
            f"{force[row]:.3g} N",
            (at, end),
            xytext=(0, 3),
            textcoords="offset points",
            color=FORCE,
            ha="center",
            va="bottom",
        )
    side.set(xlabel=f"{'xy'[across]} / mm", ylabel="z / mm", ylim=(low, high), aspect="equal", adjustable="datalim")
    pressed = -(tips if device is None else device)[:, 2]
    felt.plot(pressed, force, color=FORCE, linewidth=1.4, label="of the wall on the ball")
    if device is not None:
        played = trace["device_force_z_N"]
        felt.plot(pressed, played, color=DEVICE, linewidth=1.0, linestyle=(0, (4, 2)), label="played by the device")
    what = "ball" if device is None else "device"
    felt.set(xlabel=f"depth of the {what} below the wall's face / mm", ylabel="force along z / N")
    felt.set_xlim(left=-0.2 * max(float(pressed.max()), 1.0))
    for axes in (side, felt):
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, loc="upper left" if axes is felt else "upper right")
    felt.grid(axis="y", color="0.92", linewidth=0.6)
    title = f"{run.scene.name}: {tool.size_mm:g} mm ball on a wall of {wall.stiffness_kN_m:g} kN/m"
    chart.text(0.1, 0.965, title, va="center", size=10.5)
    save(chart, path)
