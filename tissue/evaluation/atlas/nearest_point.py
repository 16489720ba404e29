"""E12: a proxy that is the nearest free point pops through a thin wall; one that descends locally stays."""

import numpy as np
from matplotlib.figure import Figure

from meshes.base.arrays import Array
from tissue.evaluation.atlas.drawing import BLUE, GREY, RED, panel
from tissue.evaluation.atlas.page import Answer, Data, Page, Verdict, refused, shown, sweep
from tissue.haptics.proxy.proxy import Proxy
from tissue.haptics.proxy.tool_shell import ToolShell
from tissue.haptics.proxy.voxmap import Box, ContactField

__all__ = ["PAGE", "nearest_free", "point_proxy"]

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


def followed(proxy: Proxy, heights: Array) -> Array:
    """Heights of a proxy whose device goes through those given, one after the other [m]."""
    return np.array([proxy.advance(np.array([0.0, 0.0, z])).position_m[2] for z in heights.tolist()])


def sides(thickness: float) -> dict[str, float]:
    """Depths of the device at which either proxy changes sides of a wall, the end of its path where it never does."""
    walk = 0.5 * thickness - np.linspace(-0.1, 3.0, 311) * thickness
    naive = np.array([nearest_free(z, thickness) for z in walk.tolist()])
    through = followed(point_proxy(thickness, start_m=walk[0]), walk) < 0.0
    held = walk[np.argmax(through)] if through.any() else walk[-1]
    return {
        "nearest_pops_at_m": 0.5 * thickness - walk[np.argmax(naive < 0.0)],
        "ours_held_to_m": 0.5 * thickness - held,
    }


def measure(quick: bool) -> Data:
    """Both proxies over the device's path through one wall; where they change sides, over thickness."""
    depth = np.linspace(-0.5, 2.0, 26 if quick else 101) * SHOWN_M
    height = 0.5 * SHOWN_M - depth
    return {
        "way": {
            "depth_m": depth,
            "ours_m": followed(point_proxy(SHOWN_M, start_m=height[0]), height),
            "nearest_m": np.array([nearest_free(z, SHOWN_M) for z in height.tolist()]),
            "theory_m": np.maximum(height, 0.5 * SHOWN_M),
        },
        "thickness": sweep("thickness_m", np.geomspace(1e-5, 1e-2, 4 if quick else 13), sides),
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


def draw(data: Data, chart: Figure) -> None:
    """Heights over depth; depth of the change over thickness."""
    left, right = chart.subplots(1, 2)
    descent, wall = data["way"], data["thickness"]
    left.axhspan(-500.0 * SHOWN_M, 500.0 * SHOWN_M, color="0.75", zorder=1, label="wall")
    some = np.where(np.arange(len(descent["depth_m"])) % 4 == 0, 1e3, np.nan)
    panel(left, 1e3 * descent["depth_m"], "depth of the device under the face / mm", "height of the proxy / mm", [
        ("theory: stays outside", 1e3 * descent["theory_m"], "-", GREY),
        ("nearest free point (printed)", 1e3 * descent["nearest_m"], "--", RED),
        ("local descent (ours)", some * descent["ours_m"], "o", BLUE),
    ], log="")  # fmt: skip
    panel(right, 1e3 * wall["thickness_m"], "thickness of the wall / mm", "depth of the device / mm", [
        ("theory: half the thickness", 0.5e3 * wall["thickness_m"], "-", GREY),
        ("nearest point changes sides", 1e3 * wall["nearest_pops_at_m"], "s", RED),
        ("ours: still held (end of the path)", 1e3 * wall["ours_held_to_m"], "^", BLUE),
    ])  # fmt: skip


PAGE = Page(
    "nearest_point",
    "E12 · Is the proxy the nearest point of the organ?",
    "The printed proxy is an argmin over the organ's voxels. What does it do where an organ is thin?",
    "Statement E12; god-object of Zilles and Salisbury (1995)",
    measure,
    judge,
    ask,
    draw,
)
