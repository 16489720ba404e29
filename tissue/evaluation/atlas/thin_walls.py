"""Thin walls and fast tools: a penalty wall is crossed by whoever is quick enough, the god-object's is not."""

from itertools import product
from math import sqrt

import numpy as np
from matplotlib.figure import Figure

from meshes.voxels.volume import VoxelVolume
from tissue.evaluation.atlas.drawing import BLUE, GREY, ORANGE, RED, panel
from tissue.evaluation.atlas.nearest_point import nearest_free, point_proxy
from tissue.evaluation.atlas.page import Answer, Data, Page, Verdict, boundary, shown, sweep
from tissue.haptics.device.device import DeviceParameters
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.proxy.proxy import Proxy
from tissue.haptics.proxy.tool_shell import ToolShell
from tissue.haptics.proxy.voxmap import ContactField
from tissue.models.bone.bricks import BrickStore

__all__ = ["PAGE"]

STIFFNESS_N_M, MASS_KG, TICK_S = 1000.0, 0.05, 2.5e-4
"""A wall and a device whose contact lasts 22 ms; the tick leaks little over that."""
TICKS = 400
VOXEL_M = 2e-4


def end_m(speed_m_s: float, thickness_m: float, proxy: Proxy | None) -> float:
    """Height at which a device ends that is thrown at a wall from just above it [m]: with a proxy, or by penalty."""
    device = SimulatedDevice(
        DeviceParameters(mass_kg=MASS_KG, damping_N_s_m=0.0, rate_Hz=1.0 / TICK_S, force_limit_N=1e6),
        position_m=(0.0, 0.0, 0.5 * thickness_m + 1e-6),
        substeps=1,
    )
    device.translation.velocity = (0.0, 0.0, -speed_m_s)
    height = 0.0
    for tick in range(TICKS):
        sample = device.read(tick * TICK_S)
        height = sample.position_m[2] if sample is not None else height
        at = np.array([0.0, 0.0, height])
        foot = nearest_free(height, thickness_m) if proxy is None else float(proxy.advance(at).position_m[2])
        if abs(foot) > 0.5 * thickness_m + 1e-9 and abs(height) > 0.1:
            break
        device.command(np.array([0.0, 0.0, STIFFNESS_N_M * (foot - height)]), np.zeros(3))
    return height


def measure(quick: bool) -> Data:
    """The penalty's boundary over thickness; where devices end that the proxy answers, over thickness and speed."""
    thickness, speeds = np.geomspace(1e-4, 2e-2, 3 if quick else 8), [0.1, 2.0] if quick else [0.05, 0.2, 1.0, 5.0]

    def penalty(thick: float) -> dict[str, float]:
        """Speeds from which on the wall is crossed: measured, by energy, and by sampling alone."""
        crossed = boundary(lambda speed: end_m(speed, thick, None) < 0.0, 1e-3, 20.0, steps=9 if quick else 11)
        return {
            "crossed_from_m_s": crossed,
            "theory_m_s": 0.5 * thick * sqrt(STIFFNESS_N_M / MASS_KG),
            "sampling_m_s": thick / TICK_S,
        }

    pairs = np.array(list(product(thickness.tolist(), speeds)))
    ends = [end_m(speed, thick, point_proxy(thick, start_m=thick)) for thick, speed in pairs.tolist()]
    return {
        "penalty": sweep("thickness_m", thickness, penalty),
        "proxy": {"thickness_m": pairs[:, 0], "speed_m_s": pairs[:, 1], "end_m": np.array(ends)},
    }


def judge(data: Data) -> Verdict:
    """The measured boundary against the energy of half a wall, and the sides on which the others end."""
    penalty, ours = data["penalty"], data["proxy"]
    ratio = penalty["crossed_from_m_s"] / penalty["theory_m_s"]
    kept = int((ours["end_m"] > 0.0).sum())
    return Verdict(
        # A wall that is entered at a sample and left before it pushed much is crossed a little earlier or later.
        bool((np.abs(ratio - 1.0) < 0.25).all()),
        kept == len(ours["end_m"]),
        f"The penalty wall is crossed from {ratio.min():.2f} to {ratio.max():.2f} times the speed (h/2)√(K/m) on: a "
        f"wall of {1e3 * penalty['thickness_m'][0]:.1f} mm by a device at {1e3 * penalty['crossed_from_m_s'][0]:.0f} "
        f"mm/s. With the god-object {kept} of {len(ours['end_m'])} devices came back, up to "
        f"{ours['speed_m_s'].max():g} m/s.",
    )


def voxel_wall_m(speed_m_s: float) -> float:
    """Lowest height over a wall one voxel thick that a point on voxels reaches, pushed 5 mm through it [m]."""
    fraction = np.zeros((48, 48, 48), dtype=np.uint8)
    fraction[:, :, 24] = 255
    volume = VoxelVolume(
        np.zeros(3), VOXEL_M, fraction, np.zeros_like(fraction), np.full(fraction.shape, 1800, np.uint16), ("bone",)
    )
    proxy = Proxy(ToolShell.ball(), ContactField(store=BrickStore.from_volume(volume, device="cpu")))
    start = np.array([24.0, 24.0, 36.0]) * VOXEL_M
    proxy.place(start)
    lowest, steps = np.inf, max(round(5e-3 / (1e-3 * speed_m_s)), 2)
    for pushed in [*np.linspace(0.0, 5e-3, steps).tolist(), *[5e-3] * 20]:
        at = proxy.advance(start - np.array([0.0, 0.0, pushed])).position_m
        lowest = min(lowest, float(at[2]) - 24.5 * VOXEL_M)
    return lowest


def ask() -> list[Answer]:
    """One thin wall, one fast device, and a wall of voxels."""
    above = min(voxel_wall_m(speed) for speed in (0.05, 0.5, 2.0))
    proxy = point_proxy(2e-5, start_m=1e-3)
    rest = proxy.advance(np.array([0.0, 0.0, -5e-2])).position_m[2]
    back = end_m(2.0, 1e-3, point_proxy(1e-3, start_m=1e-3))
    return [
        shown(
            "a wall of bone one voxel thick, at 0.05 to 2 m/s",
            above > 0.0,
            f"the proxy stays {1e3 * above:.2f} mm or more above its middle, voxels of {1e3 * VOXEL_M:g} mm",
        ),
        shown(
            "a point at 50 m/s onto 20 µm of wall",
            abs(rest - 1e-5) < 1e-9,
            f"stops {1e6 * rest:.0f} µm above its middle",
        ),
        shown(
            "a free device thrown at 1 mm of wall at 2 m/s",
            back > 0.0,
            f"it is {1e3 * back:.0f} mm off again after 0.1 s",
        ),
    ]


def draw(data: Data, chart: Figure) -> None:
    """Speed over thickness."""
    axes, penalty, ours = chart.subplots(), data["penalty"], data["proxy"]
    for back, style, what in ((ours["end_m"] > 0.0, "o", "thrown back"), (ours["end_m"] <= 0.0, "x", "crossed")):
        if back.any():
            across, up = 1e3 * ours["thickness_m"][back], ours["speed_m_s"][back]
            axes.plot(across, up, style, color=BLUE, label=f"god-object: {what}")
    panel(axes, 1e3 * penalty["thickness_m"], "thickness of the wall / mm", "speed of the device / (m/s)", [
        ("theory: (h/2)√(K/m)", penalty["theory_m_s"], "-", GREY),
        ("penalty wall is crossed from here up", penalty["crossed_from_m_s"], "s", RED),
        ("one tick is longer than the wall", penalty["sampling_m_s"], ":", ORANGE),
    ], title="who is thrown back? device of 50 g, wall of 1 kN/m", ylim=(0.5e-3, 20.0))  # fmt: skip


PAGE = Page(
    "thin_walls",
    "Thin walls and fast tools",
    "A device is thrown at a wall. From which speed on does a penalty that pushes to the nearest face let it through, "
    "and what does a proxy make of it?",
    "Energy of half a wall, ½mv² = ½K(h/2)²; tick 0.25 ms, nobody holds the device",
    measure,
    judge,
    ask,
    draw,
)
