"""Stability map of a scene's haptic loop, in words and as files (`tissue stability`)."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from meshes.base.errors import InputError, enumerated
from meshes.base.whole_file import write_columns
from tissue.haptics.loop.critical_stiffness import critical_stiffness_N_m, in_hands, settling_hands
from tissue.haptics.loop.stability_map import StabilityChart, StabilityMap, stability_map
from tissue.models.tissue_model import TICK_S
from tissue.scene.registry import DEVICES
from tissue.scene.scene import Scene
from tissue.show.figures.figure import figure, save
from tissue.simulation.builders.loop import (
    horizon_text,
    judged_loop,
    lead_ticks,
    loop_settings,
)
from tissue.system.owned_folder import OwnedFolder

FILES = ("stability.png", "stability_damping.csv", "stability_delay.csv")
LABELS = {
    "wall_damping_N_s_m": ("virtual damping / N s/m", 1.0),
    "delay_s": ("delay added to the hold / ms", 1e3),
}
LINES = {
    "passive": ("#009E73", "--"),
    "first order in delay": ("#E69F00", "-."),
    "Pade": ("#CC79A7", ":"),
}


def scene_stability(scene: Scene) -> StabilityMap:
    """Compute the stability map of the closed loop formed by a scene's device and operator.

    The hand is modelled with and without its stretch reflex; the model with the lower critical
    stiffness is used.

    Raises
    ------
    InputError
        If the scene has no device.
    """
    if scene.device is None:
        raise InputError(
            "device",
            "be given for a stability map",
            "none",
            f"pass --set device=NAME with {enumerated(DEVICES, 'or')}",
        )
    settings = loop_settings(scene)
    loop = judged_loop(settings)
    held = in_hands(loop, settling_hands(loop, settings.person.linear_hands))
    return stability_map(min(held, key=critical_stiffness_N_m))


def stability_lines(scene: Scene, found: StabilityMap) -> list[str]:
    """Describe in words the stability of the coupling, and the critical stiffness for each delay.

    The critical stiffness at each delay is computed from eigenvalues and measured in a simulation.
    The passivity bound is also given.
    """
    chosen = found.chosen
    data = found.over_delay
    delay_ms = 1e3 * chosen.delay_s
    coupling_ms = scene.held.coupling.delay_ms
    horizon = ""
    if scene.held.prediction != "none":
        horizon_ms = 1e3 * TICK_S * lead_ticks(loop_settings(scene))
        horizon = f"; prediction horizon {horizon_text(horizon_ms, coupling_ms)}"
    return [
        f"{scene.held.kind} in the hand of a person of the group {scene.held.hand}, "
        f"{1e-3 / chosen.tick_s:g} kHz, "
        f"delay {delay_ms:g} ms (coupling.delay_ms = {coupling_ms:g}, and "
        f"{delay_ms - coupling_ms:.3g} ms for device and tissue model), zero-order hold, "
        f"low-pass {1e3 * chosen.filter_s:g} ms{horizon}",
        f"chosen: {_chosen(found)}",
        *(
            f"delay {1e3 * data.values[index]:4.1f} ms: stable below "
            f"{data.exact_N_m[index]:8.0f} N/m by eigenvalues, "
            f"{data.measured_N_m[index]:8.0f} measured, "
            f"{data.lines_N_m['passive'][index]:6.0f} passive"
            # every sixth delay: a few lines of text
            for index in range(0, len(data.values), 6)
        ),
    ]


def _chosen(found: StabilityMap) -> str:
    """Describe whether the coupling stiffness is stable, and for which delay this is valid."""
    chosen = found.chosen
    verdict = found.verdict.sentence(chosen.stiffness_N_m)
    return f"{verdict} at a delay of {1e3 * chosen.delay_s:g} ms"


def write_stability_files(
    scene: Scene, found: StabilityMap, folder: Path, *, overwrite: bool
) -> list[Path]:
    """Write the picture of a stability map, and tables of the stability boundaries [N/m].

    The tables are ``stability_damping.csv`` (boundaries against damping) and
    ``stability_delay.csv`` (boundaries against delay).

    Raises
    ------
    InputError
        If `folder` is a file, or already contains a map and `overwrite` is false.
    """
    with OwnedFolder(folder, "map", FILES, overwrite=overwrite):
        _draw_stability(
            found, folder / FILES[0], title=f"{scene.name}: {scene.held.kind}, {scene.held.hand}"
        )
        for name, data in zip(FILES[1:], (found.over_damping, found.over_delay), strict=True):
            lines = {
                f"{line.replace(' ', '_')}_N_m": values for line, values in data.lines_N_m.items()
            }
            columns = {
                data.along: data.values,
                "measured_N_m": data.measured_N_m,
                "exact_N_m": data.exact_N_m,
            }
            write_columns(folder / name, columns | lines)
    return [folder / name for name in FILES]


def _draw_stability(found: StabilityMap, path: Path, *, title: str) -> None:
    """Draw the stable range of the coupling stiffness against damping and against delay.

    Shading marks points that are unstable by eigenvalues. The charts also show the measured
    boundary, theoretical bounds, and the chosen stiffness.
    """
    # inches; the margins are shares of the figure: title and chosen point above, legend below
    chart = figure(9.0, 4.9)
    axes = chart.subplots(1, 2)
    chart.subplots_adjust(left=0.09, right=0.98, top=0.84, bottom=0.25, wspace=0.24)
    for panel, data in zip(axes, (found.over_damping, found.over_delay), strict=True):
        _draw(panel, data, found)
    chart.legend(*axes[0].get_legend_handles_labels(), loc="lower center", ncols=3, frameon=False)
    chart.text(0.09, 0.95, title, va="center", size=11)
    chosen = f"chosen: {_chosen(found)}"
    chart.text(0.09, 0.895, chosen, va="center", size=9, color="0.25")
    save(chart, path)


def _draw(panel: Axes, data: StabilityChart, found: StabilityMap) -> None:
    """Draw the chart of stiffness against one parameter."""
    label, scale = LABELS[data.along]
    across = scale * data.values
    low = data.stiffnesses_N_m[0]
    high = data.stiffnesses_N_m[-1]
    grows = np.where(data.growth >= 1.0, 1.0, np.nan)
    panel.pcolormesh(
        # a value of 1 of 4 is a light grey
        across,
        data.stiffnesses_N_m,
        grows,
        cmap="Greys",
        vmin=0.0,
        vmax=4.0,
        shading="nearest",
    )
    panel.plot(across, data.exact_N_m, color="0.1", label="eigenvalues, exact delay")
    panel.plot(
        # every other mark, so that the line of the eigenvalues stays visible
        across[::2],
        data.measured_N_m[::2],
        "o",
        color="#0072B2",
        label="measured by running it",
    )
    for name, values in data.lines_N_m.items():
        colour, line = LINES[name]
        shown = np.where((values > low) & (values < high), values, np.nan)
        panel.plot(across, shown, color=colour, linestyle=line, label=name)
    x = scale * getattr(found.chosen, data.along)
    panel.plot(
        [x],
        [found.chosen.stiffness_N_m],
        "*",
        color="#D55E00",
        label="chosen",
    )
    panel.set(xlabel=label, ylabel="stiffness / N/m", yscale="log", ylim=(low, high))
    panel.grid(alpha=0.3, which="both")
