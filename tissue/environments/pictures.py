"""Pictures of the environments: a section through the bone under the tool, or felt forces."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from meshes.base.arrays import Bytes
from tissue.environments.environment import ContactEnvironment
from tissue.environments.restorable_bone import RestorableBone

if TYPE_CHECKING:
    from tissue.environments.drilling import Drilling
    from tissue.environments.milling import Milling
    from tissue.environments.palpation import Palpation

__all__ = ["drilling_picture", "milling_picture", "palpation_picture"]

SIZE_IN, DPI = (6.4, 3.6), 100
MILLING_COLOURS = ("#D55E00", "#F0C090", "#D8D2C4")
TOOTH_COLOURS = ("#CFE3F2", "#E8D3A2", "#D55E00", "#8C6D46", "#B0A0C0", "#D8D2C4")


def _canvas(env: ContactEnvironment, panels: int) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=SIZE_IN, dpi=DPI, layout="constrained")
    force = float(np.linalg.norm(env.mean_force_N))
    done_s = (1.0 - env.time_left) * env.duration_s
    figure.suptitle(f"{done_s:.2f} s, {force:.3g} N, score {env.score:.3f}", fontsize=10)
    return figure, list(np.atleast_1d(figure.subplots(1, panels)))


def _pixels(figure: Figure) -> Bytes:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.array(canvas.buffer_rgba(), dtype=np.uint8)[..., :3]


def _section(
    panel: Axes, bone: RestorableBone, across: int, at_m: float, colours: tuple[str, ...]
) -> None:
    """Draw the layers of the remaining bone in the plane across an axis [m]."""
    volume = bone.model.store.volume
    assert volume is not None
    place = int(
        np.clip((at_m - volume.origin_m[across]) / volume.spacing_m, 0, volume.shape[across] - 1)
    )
    left = np.take(bone.model.remaining(), place, axis=across) > 127
    shown = np.where(left, np.take(volume.layer, place, axis=across).astype(np.int64), -1)
    first, second = (axis for axis in range(3) if axis != across)
    low = 1e3 * volume.origin_m
    high = low + 1e3 * volume.spacing_m * np.array(volume.shape)
    extent = (low[first], high[first], low[second], high[second])
    shades = ListedColormap(["#FFFFFF", *colours])
    panel.imshow(
        shown.T, origin="lower", extent=extent, cmap=shades, vmin=-1.5, vmax=len(colours) - 0.5
    )
    panel.set_xlabel(f"{'xyz'[first]} / mm")
    panel.set_ylabel(f"{'xyz'[second]} / mm")


def milling_picture(env: "Milling") -> Bytes:
    """Draw sections under the burr along x, and through the pocket at half its depth.

    The target is orange.
    """
    figure, (side, top) = _canvas(env, 2)
    tip = env.tip_mm
    radius = 1e3 * env.bone.model.cutter.profile.radius_m
    _section(side, env.bone, 1, 1e-3 * tip[1], MILLING_COLOURS)
    side.add_patch(Circle((tip[0], tip[2] + radius), radius, fill=False, color="0.2"))
    side.set_ylim(-3.6, 4.5)
    _section(top, env.bone, 2, -0.5e-3 * env.pocket_mm[2], MILLING_COLOURS)
    top.plot(tip[0], tip[1], "+", color="0.2")
    return _pixels(figure)


def drilling_picture(env: "Drilling") -> Bytes:
    """Draw a section along x under the bur, with the wanted depth."""
    figure, (side,) = _canvas(env, 1)
    tip = 1e3 * env.tool.tip_m
    radius = 1e3 * env.bone.model.cutter.profile.radius_m
    _section(side, env.bone, 1, env.tool.tip_m[1], TOOTH_COLOURS)
    side.add_patch(Circle((tip[0], tip[2] + radius), radius, fill=False, color="0.2"))
    side.axhline(
        1e3 * (env.surface_m - env.wanted_m),
        color="0.2",
        linestyle="--",
        linewidth=1.0,
        label="wanted depth",
    )
    side.set_ylim(-4.0, 2.5)
    side.legend(loc="lower right", fontsize=8)
    return _pixels(figure)


def palpation_picture(env: "Palpation") -> Bytes:
    """Draw the fingertip's path, coloured by its force, and the position of the nodule."""
    figure, (top,) = _canvas(env, 1)
    x, y, _, force = np.array(env.path).T
    shown = top.scatter(x, y, c=force, s=12, cmap="viridis")
    figure.colorbar(shown, ax=top, label="force along z / N")
    at = 1e3 * env.nodule_m
    reach = 1e3 * env.reach_m
    top.add_patch(
        Circle(
            (at[0], at[1]), 1e3 * env.nodule_radius_m, fill=False, color="#D55E00", linestyle="--"
        )
    )
    top.add_patch(Rectangle((-reach, -reach), 2.0 * reach, 2.0 * reach, fill=False, color="none"))
    top.plot(x[-1], y[-1], "o", color="0.2", fillstyle="none", markersize=10)
    top.set(
        xlabel="x / mm", ylabel="y / mm", xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal"
    )
    return _pixels(figure)
