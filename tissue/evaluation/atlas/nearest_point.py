"""E12: a proxy that is the nearest free point pops through a thin wall; one that descends locally stays."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue.evaluation.atlas.drawing import BLUE, GREY, RED, finish, region
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Verdict, refused, shown
from tissue.haptics.proxy.proxy import Proxy
from tissue.haptics.proxy.tool_shell import ToolShell
from tissue.haptics.proxy.voxmap import Box, ContactField

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["NEAREST_POINT", "nearest_free", "point_proxy"]

Array = NDArray[np.float64]
SHOWN_M = 1e-3
"""Thickness of the wall whose passage is drawn."""
EDGE_M = 0.1


def point_proxy(thickness_m: float, *, start_m: float) -> Proxy:
    """A point above a wall about z = 0."""
    wall = Box(np.zeros(3), np.array([EDGE_M, EDGE_M, thickness_m]))
    proxy = Proxy(ToolShell.ball(), ContactField(wall))
    proxy.place(np.array([0.0, 0.0, start_m]))
    return proxy


def nearest_free(height_m: float, thickness_m: float) -> float:
    """Height of the free point nearest to a device [m]: the printed argmin, in closed form."""
    half = 0.5 * thickness_m
    return height_m if abs(height_m) >= half else float(np.copysign(half, height_m))


def measure(quick: bool) -> Data:
    """Both proxies over the device's path through one wall; where they change sides, over thickness."""
    depth = np.linspace(-0.5, 2.0, 26 if quick else 101) * SHOWN_M
    height = 0.5 * SHOWN_M - depth
    proxy = point_proxy(SHOWN_M, start_m=height[0])
    ours = np.array([proxy.advance(np.array([0.0, 0.0, z])).position_m[2] for z in height.tolist()])
    thickness = np.geomspace(1e-5, 1e-2, 4 if quick else 13)
    popped, held = np.zeros(len(thickness)), np.zeros(len(thickness))
    for number, thick in enumerate(thickness.tolist()):
        walk = 0.5 * thick - np.linspace(-0.1, 3.0, 311) * thick
        follower = point_proxy(thick, start_m=walk[0])
        naive = np.array([nearest_free(z, thick) for z in walk.tolist()])
        kept = np.array([follower.advance(np.array([0.0, 0.0, z])).position_m[2] for z in walk.tolist()])
        popped[number] = 0.5 * thick - walk[np.argmax(naive < 0.0)]
        through = kept < 0.0
        held[number] = 0.5 * thick - (walk[np.argmax(through)] if through.any() else walk[-1])
    return {
        "way": {
            "depth_m": depth,
            "ours_m": ours,
            "nearest_m": np.array([nearest_free(z, SHOWN_M) for z in height.tolist()]),
            "theory_m": np.maximum(height, 0.5 * SHOWN_M),
        },
        "thickness": {"thickness_m": thickness, "nearest_pops_at_m": popped, "ours_held_to_m": held},
    }


def judge(data: Data) -> Verdict:
    """Where the nearest point changes sides against half the thickness, and whether ours ever does."""
    descent, wall = data["way"], data["thickness"]
    share = wall["nearest_pops_at_m"] / wall["thickness_m"]
    off = float(np.abs(descent["ours_m"] - descent["theory_m"]).max())
    deepest = float((wall["ours_held_to_m"] / wall["thickness_m"]).min())
    return Verdict(
        bool((np.abs(share - 0.5) < 0.02).all()),
        off < 1e-9 and deepest > 2.9,
        f"The nearest free point changes sides at {share.min():.2f} to {share.max():.2f} of the thickness, whatever it "
        f"is (theory ½). The proxy that descends from its last place keeps to the surface to {off:.0e} m and was still "
        f"outside with the device {deepest:.1f} thicknesses deep, down to walls of "
        f"{1e6 * wall['thickness_m'].min():.0f} µm.",
    )


def ask() -> list[Answer]:
    """A start inside the wall, a device that is not a number, and one that jumps to the far side."""
    proxy = point_proxy(1e-3, start_m=2e-3)
    inside = proxy.advance(np.array([0.0, 0.0, -5e-3])).position_m[2]
    return [
        refused("a proxy placed inside a wall", lambda: point_proxy(1e-3, start_m=0.0)),
        refused("a device that is nowhere", lambda: point_proxy(1e-3, start_m=2e-3).advance(np.full(3, np.nan))),
        shown(
            "a jump of 7 mm through 1 mm of wall",
            abs(inside - 5e-4) < 1e-9,
            f"rests {1e3 * inside:g} mm above its middle",
        ),
    ]


def draw(data: Data, chart: "Figure") -> None:
    """Heights over depth; depth of the change over thickness."""
    left, right = chart.subplots(1, 2)
    descent, wall = data["way"], data["thickness"]
    depth = 1e3 * descent["depth_m"]
    region(left, Conduct.HOLDS, depth[0], depth[-1])
    left.axhspan(-500.0 * SHOWN_M, 500.0 * SHOWN_M, color="0.75", zorder=1, label="wall")
    left.plot(depth, 1e3 * descent["theory_m"], color=GREY, zorder=3, label="theory: stays outside")
    left.plot(depth, 1e3 * descent["nearest_m"], "--", color=RED, zorder=3, label="nearest free point (printed)")
    left.plot(depth[::4], 1e3 * descent["ours_m"][::4], "o", color=BLUE, zorder=4, label="local descent (ours)")
    finish(left, "depth of the device under the face / mm", "height of the proxy / mm", xlim=depth[[0, -1]])
    thickness = 1e3 * wall["thickness_m"]
    region(right, Conduct.HOLDS, thickness[0], thickness[-1])
    right.loglog(thickness, 0.5 * thickness, color=GREY, label="theory: half the thickness")
    right.loglog(thickness, 1e3 * wall["nearest_pops_at_m"], "s", color=RED, label="nearest point changes sides")
    right.loglog(thickness, 1e3 * wall["ours_held_to_m"], "^", color=BLUE, label="ours: still held (end of the path)")
    finish(right, "thickness of the wall / mm", "depth of the device / mm", xlim=thickness[[0, -1]])


NEAREST_POINT = Page(
    "nearest_point",
    "E12 · Is the proxy the nearest point of the organ?",
    "The printed proxy is an argmin over the organ's voxels. What does it do where an organ is thin?",
    "Statement E12; god-object of Zilles and Salisbury (1995)",
    measure,
    judge,
    ask,
    draw,
)
