"""Pictures of perception.

The pictures show intensity and threshold, the commanded force, and the effect of the deadband on a
recorded force.
"""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tissue.haptics.device.device import device_parameters
from tissue.haptics.loop.filters import ForceRange
from tissue.materials.constants import constants
from tissue.perception.laws import intensity_of, weber_of
from tissue.perception.observer import (
    Observer,
    population,
    population_observer,
    read_observer,
    reference_observer,
)
from tissue.perception.perceived import PerceivedForce, held_back
from tissue.scene.load import load_scene
from tissue.show.figures.figure import figure, save
from tissue.simulation.builders.prediction import CAUTION, perception
from tissue.simulation.simulate import simulate
from tissue.system.owned_folder import OwnedFolder

__all__ = ["perception_charts"]


POPULATION = "#0072B2"
PERSON = "#D55E00"
WANTED = "0.25"
GREY = "0.6"
DEVICE = "touch"
SCENE = "wall"
EXAMPLE = Observer.known(
    "example", alpha=0.7, beta=1.4, kappa=0.09, offset_N=0.25, lapse=0.02, sigma=0.2
)
"""Simulated observer that is drawn by default.

The intensity that this observer perceives increases less with the force than the intensity that the
reference observer perceives.
"""


def perception_charts(out: Path, observer: Path | None, *, overwrite: bool) -> list[Path]:
    """Draw all pictures of the observer in a file, or of `EXAMPLE` without a file, into a folder.

    Raises
    ------
    InputError
        If the observer's file cannot be used, or the folder is a file or holds such pictures.
    """
    someone = EXAMPLE if observer is None else read_observer(observer)
    drawn = {"people": _people, "command": _command, "deadband": _deadband}
    pictures = {f"perception-{name}.png": draw for name, draw in drawn.items()}
    with OwnedFolder(out, "chart", pictures, overwrite=overwrite):
        for name, draw in pictures.items():
            draw(someone, out / name)
    return [out / name for name in pictures]


def _people(someone: Observer, path: Path) -> None:
    """Draw perceived intensity and threshold against force, for the population and one observer."""
    chart, (left, right) = _panels(1, 2)
    # a decade on both sides of 1 N, where the reference's intensity is 1
    forces = np.geomspace(0.1, 10.0, 200)
    for name, entry in constants("perception", "exponent").items():
        left.plot(forces, forces**entry.value, ":", color=GREY)
        # to the right of the curves, which end at 10 N
        left.text(10.3, 10.0**entry.value, name.replace("_", " "), color="0.3")
    # with 4000 people, the ends of the 80 % range have an error of 0.5 % of the people
    drawn = population().draws(4000, np.random.default_rng(0))
    percent = 100.0 * drawn["kappa"] * (1.0 + drawn["offset_N"] / forces[:, None])
    # eight in ten people lie between them
    low, high = np.quantile(percent, [0.1, 0.9], axis=1)
    right.fill_between(forces, low, high, color=POPULATION, alpha=0.18, label="eight in ten people")
    # 7 % from 2.5 to 10 N
    right.plot([2.5, 10.0], [7.0, 7.0], color="#009E73", label="Pang et al. 1991")
    for who, colour in ((population_observer(), POPULATION), (someone, PERSON)):
        law = intensity_of(who)
        mean = law.expected(forces)
        spread = law.spread(forces)
        # logarithmic axes show no zero
        low = np.maximum(mean - spread, 1e-4)
        left.fill_between(forces, low, mean + spread, color=colour, alpha=0.18)
        left.plot(forces, mean, color=colour, label=f"{who.name}: mean, ± 1 standard deviation")
        threshold = 100.0 * weber_of(who).threshold(forces) / forces
        right.plot(forces, threshold, color=colour, label=who.name)
    wanted = intensity_of(reference_observer()).expected(forces)
    left.plot(forces, wanted, "--", color=WANTED, label="reference")
    # the limits hold all curves; beyond 10 N they leave space for the names of the exponents
    left.set(xscale="log", yscale="log", ylim=(0.01, 200.0), xlim=(0.1, 45.0))
    left.set(xlabel="force / N", ylabel="intensity / reference's at 1 N")
    right.set(xscale="log", xlabel="force / N", ylabel="threshold / % of the force", ylim=(0, 46))
    _finish(chart, path)


def _command(someone: Observer, path: Path) -> None:
    """Draw the played force, and its perceived intensity, against the physical force."""
    chart, (left, right) = _panels(1, 2)
    limit_N = device_parameters(DEVICE).force_limit_N
    device = ForceRange(limit_N=limit_N)
    # up to three times the limit, where the played force has reached it
    forces = np.geomspace(0.02, 3.0 * limit_N, 600)
    # exponent of muscle force (Stevens), the reference's
    right.plot(forces, forces**1.7, "--", color=WANTED, label="wanted: reference, physical force")
    for who, colour in ((population_observer(), POPULATION), (someone, PERSON)):
        rng = np.random.default_rng(0)
        made = perception(who, rng=rng, force_limit_N=limit_N, tick_s=1e-3)
        assert isinstance(made, PerceivedForce)
        law = made.law
        commands = law.command_N(forces)
        played = np.array([device.play(np.array([force, 0.0, 0.0]))[0][0] for force in commands])
        left.plot(forces, played, color=colour, label=f"{who.name}, gain {law.gain:.2f}")
        felt = intensity_of(who)
        shown = felt.expected(played) / felt.expected(law.command_N(1.0))
        plain = felt.expected(forces) / felt.expected(1.0)
        right.plot(forces, shown, color=colour, label=f"{who.name}, commanded")
        right.plot(forces, plain, "-.", color=colour, label=f"{who.name}, physical force")
    left.plot(forces, forces, "--", color=WANTED, label="physical force")
    left.axhline(limit_N, color=GREY, label=f"limit of {DEVICE}")
    for axes in (left, right):
        axes.axvline(device.knee_N, color=GREY, linestyle="--")
        # these limits and those below hold all curves
        axes.set(xscale="log", yscale="log", xlabel="force at the device / N", xlim=(0.05, 10.0))
    left.set(ylabel="force played / N", ylim=(0.02, 8.0))
    right.set(ylabel="intensity / that at 1 N", ylim=(0.005, 60.0))
    right.set_title("ratios are kept up to the dashed knee")
    _finish(chart, path)


def _deadband(someone: Observer, path: Path) -> None:
    """Draw a recorded force, and the force that is played with the deadband."""
    # the seed does not matter: the title states the share of this run
    run = simulate(load_scene(SCENE, {"device": DEVICE, "hand": "novice", "seed": 3}))
    wanted = run.trace.vectors("filtered_force", "N")
    time = run.trace["time_s"]
    law = weber_of(someone, quantile=CAUTION)
    played, changed = held_back(wanted, law)
    size = np.linalg.norm(wanted, axis=1)
    shown = np.linalg.norm(played, axis=1)
    threshold = law.threshold(shown)
    contact = size > law.kappa * law.offset
    chart, (upper, lower) = _panels(2, 1)
    upper.fill_between(
        time, shown - threshold, shown + threshold, alpha=0.18, label="not perceived as a change"
    )
    upper.plot(time, size, color=WANTED, label="wanted")
    upper.step(time, shown, color=POPULATION, where="post", label="played")
    upper.plot(time[changed], shown[changed], "o", color=PERSON, markersize=3.5, label="changes")
    upper.set(ylabel="force / N", ylim=(0.0, None))
    saved = 100.0 * (1.0 - changed[contact].mean())
    upper.set_title(
        f"{SCENE} by a novice, {someone.name}: {saved:.1f} % of the samples in contact are not "
        "needed"
    )
    error = np.linalg.norm(wanted - played, axis=1) / threshold
    lower.plot(time, error, color=POPULATION, label="error / threshold")
    lower.axhline(1.0, color="0.3", linestyle="--")
    # the error stays below 1 by construction
    lower.set(xlabel="time / s", ylim=(0.0, 1.15))
    for axes in (upper, lower):
        # 20 ms before and after the contact
        axes.set_xlim(time[contact][[0, -1]] + [-0.02, 0.02])
    _finish(chart, path)


def _panels(rows: int, columns: int) -> tuple[Figure, tuple[Axes, Axes]]:
    """Return a figure with two panels, and the axes of the panels."""
    # inches; two panels side by side, or one below the other
    chart = figure(10.0, 4.6)
    chart.set_layout_engine("constrained")
    first, second = chart.subplots(rows, columns)
    return chart, (first, second)


def _finish(chart: Figure, path: Path) -> None:
    """Add grids and legends to a figure, and write its file."""
    for axes in chart.axes:
        axes.grid(alpha=0.3)
        axes.legend(loc="best")
    save(chart, path)
