"""Thin walls and fast tools: a fast tool crosses a penalty wall, but not one that a proxy
renders.
"""

from itertools import product
from math import sqrt

import numpy as np
from matplotlib.figure import Figure

from meshes.voxels.volume import VoxelVolume
from tissue.evaluation.atlas.page import (
    BLUE,
    GREY,
    ORANGE,
    RED,
    Answer,
    Data,
    Page,
    Verdict,
    boundary,
    panel,
    refused,
    shown,
    sweep,
)
from tissue.haptics.device.device import DeviceParameters
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.proxy.proxy import Box, ContactField, Proxy, ToolShell
from tissue.models.bone.bricks import BrickStore

__all__ = ["PAGE"]

STIFFNESS_N_M = 1000.0
MASS_KG = 0.05
TICK_S = 2.5e-4
"""Wall and device whose contact lasts 22 ms. At this tick the hold leaks little energy in that
time.
"""
TICKS = 400
VOXEL_M = 2e-4


def point_proxy(thickness_m: float, *, start_m: float) -> Proxy:
    """Return a point proxy above a wall about z = 0."""
    wall = Box(np.zeros(3), np.array([0.1, 0.1, thickness_m]))
    proxy = Proxy(ToolShell.ball(), ContactField(wall))
    proxy.place(np.array([0.0, 0.0, start_m]))
    return proxy


def nearest_free(height_m: float, thickness_m: float) -> float:
    """Return the height of the free point nearest to a device [m]."""
    half = 0.5 * thickness_m
    return height_m if abs(height_m) >= half else float(np.copysign(half, height_m))


def end_m(speed_m_s: float, thickness_m: float, proxy: Proxy | None) -> float:
    """Compute the final height of a device thrown at a wall from just above it [m].

    The force is a penalty force if no proxy is given.
    """
    device = SimulatedDevice(
        DeviceParameters(
            mass_kg=MASS_KG, damping_N_s_m=0.0, rate_Hz=1.0 / TICK_S, force_limit_N=1e6
        ),
        position_m=(0.0, 0.0, 0.5 * thickness_m + 1e-6),
        substeps=1,
    )
    device.translation.velocity = (0.0, 0.0, -speed_m_s)
    height = 0.0
    for tick in range(TICKS):
        sample = device.read(tick * TICK_S)
        height = sample.position_m[2] if sample is not None else height
        if proxy is None:
            foot = nearest_free(height, thickness_m)
        else:
            foot = float(proxy.advance(np.array([0.0, 0.0, height])).position_m[2])
        if abs(foot) > 0.5 * thickness_m + 1e-9 and abs(height) > 0.1:
            break
        device.command(np.array([0.0, 0.0, STIFFNESS_N_M * (foot - height)]), np.zeros(3))
    return height


def measure(quick: bool) -> Data:
    """Find the crossing speed of the penalty wall over thickness, and throw devices at proxies."""
    thickness = np.geomspace(1e-4, 2e-2, 3 if quick else 8)
    speeds = [0.1, 2.0] if quick else [0.05, 0.2, 1.0, 5.0]

    def penalty(thick: float) -> dict[str, float]:
        """Return the crossing speed: measured, by energy, and by sampling alone."""
        crossed = boundary(
            lambda speed: end_m(speed, thick, None) < 0.0, 1e-3, 20.0, steps=9 if quick else 11
        )
        return {
            "crossed_from_m_s": crossed,
            "theory_m_s": 0.5 * thick * sqrt(STIFFNESS_N_M / MASS_KG),
            "sampling_m_s": thick / TICK_S,
        }

    pairs = np.array(list(product(thickness.tolist(), speeds)))
    ends = [
        end_m(speed, thick, point_proxy(thick, start_m=thick)) for thick, speed in pairs.tolist()
    ]
    return {
        "penalty": sweep("thickness_m", thickness, penalty),
        "proxy": {"thickness_m": pairs[:, 0], "speed_m_s": pairs[:, 1], "end_m": np.array(ends)},
    }


def judge(data: Data) -> Verdict:
    """Compare the crossing speed with the energy of half a wall, and count rejected devices.

    A rejected device is thrown back by a proxy.
    """
    penalty = data["penalty"]
    thrown = data["proxy"]
    ratio = penalty["crossed_from_m_s"] / penalty["theory_m_s"]
    kept = int((thrown["end_m"] > 0.0).sum())
    return Verdict(
        # The sampling moves the crossing speed: a device may enter at a sample and leave before it
        # was pushed much.
        bool((np.abs(ratio - 1.0) < 0.25).all()),
        kept == len(thrown["end_m"]),
        f"Devices cross the penalty wall from {ratio.min():.2f} to {ratio.max():.2f} times "
        "the speed (h/2)√(K/m) on: "
        f"a wall of {1e3 * penalty['thickness_m'][0]:.1f} mm at "
        f"{1e3 * penalty['crossed_from_m_s'][0]:.0f} mm/s. "
        f"With the proxy {kept} of {len(thrown['end_m'])} devices come back, up to "
        f"{thrown['speed_m_s'].max():g} m/s.",
    )


def voxel_wall_m(speed_m_s: float) -> float:
    """Push a point 5 mm through a wall one voxel thick.

    Return its lowest height over the middle of the wall [m].
    """
    fraction = np.zeros((48, 48, 48), dtype=np.uint8)
    fraction[:, :, 24] = 255
    density = np.full(fraction.shape, 1800, np.uint16)
    volume = VoxelVolume(
        np.zeros(3), VOXEL_M, fraction, np.zeros_like(fraction), density, ("bone",)
    )
    proxy = Proxy(
        ToolShell.ball(), ContactField(store=BrickStore.from_volume(volume, device="cpu"))
    )
    start = np.array([24.0, 24.0, 36.0]) * VOXEL_M
    proxy.place(start)
    lowest = np.inf
    steps = max(round(5e-3 / (1e-3 * speed_m_s)), 2)
    for pushed in [*np.linspace(0.0, 5e-3, steps).tolist(), *[5e-3] * 20]:
        at = proxy.advance(start - np.array([0.0, 0.0, pushed])).position_m
        lowest = min(lowest, float(at[2]) - 24.5 * VOXEL_M)
    return lowest


def ask() -> list[Answer]:
    """Push a proxy at a wall of voxels and at thin walls."""
    above = min(voxel_wall_m(speed) for speed in (0.05, 0.5, 2.0))
    rest = point_proxy(2e-5, start_m=1e-3).advance(np.array([0.0, 0.0, -5e-2])).position_m[2]
    back = end_m(2.0, 1e-3, point_proxy(1e-3, start_m=1e-3))
    return [
        shown(
            "a wall of bone one voxel thick, at 0.05 to 2 m/s",
            above > 0.0,
            (
                f"the proxy stays {1e3 * above:.2f} mm or more above its middle, voxels of "
                f"{1e3 * VOXEL_M:g} mm"
            ),
        ),
        shown(
            "a point at 50 m/s onto 20 µm of wall",
            abs(rest - 1e-5) < 1e-9,
            f"stops {1e6 * rest:.0f} µm above its middle",
        ),
        shown(
            "a free device thrown at 1 mm of wall at 2 m/s",
            back > 0.0,
            f"it is {1e3 * back:.0f} mm away after 0.1 s",
        ),
        refused("a proxy placed inside a wall", lambda: point_proxy(1e-3, start_m=0.0)),
    ]


def draw(data: Data, chart: Figure) -> None:
    """Draw the speed over the thickness."""
    axes = chart.subplots()
    penalty = data["penalty"]
    thrown = data["proxy"]
    back = thrown["end_m"] > 0.0
    for chosen, style, label in ((back, "o", "thrown back"), (~back, "x", "crossed")):
        if chosen.any():
            across = 1e3 * thrown["thickness_m"][chosen]
            axes.plot(
                across, thrown["speed_m_s"][chosen], style, color=BLUE, label=f"proxy: {label}"
            )
    panel(
        axes,
        1e3 * penalty["thickness_m"],
        ("thickness of the wall / mm", "speed of the device / (m/s)"),
        [
            ("theory: (h/2)√(K/m)", penalty["theory_m_s"], "-", GREY),
            ("penalty wall is crossed from here up", penalty["crossed_from_m_s"], "s", RED),
            ("one tick is longer than the wall", penalty["sampling_m_s"], ":", ORANGE),
        ],
        title="device of 50 g, wall of 1 kN/m",
        ylim=(0.5e-3, 20.0),
    )


PAGE = Page(
    "thin_walls",
    "Thin walls and fast tools",
    "A device is thrown at a wall. From which speed on does a penalty that pushes to the "
    "nearest face let it through, "
    "and does a proxy hold it?",
    (
        "Energy of half a wall, ½mv² = ½K(h/2)²; god-object of Zilles and Salisbury (1995); tick "
        "0.25 ms, no hand"
    ),
    measure,
    judge,
    ask,
    draw,
)
