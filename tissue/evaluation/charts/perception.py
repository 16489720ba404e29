"""What people feel as pictures: intensity and threshold, the command, the deadband on a trace, the estimate."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tissue.builders.perception import CAUTION, perception_for
from tissue.figures.figure import figure, save
from tissue.haptics.device.device import device_parameters
from tissue.haptics.loop.filters import ForceRange
from tissue.materials.constants import constants
from tissue.perception.estimate import log_posterior, map_estimate_errors, map_force_N, recursive_estimate_errors
from tissue.perception.laws import intensity_of, weber_of
from tissue.perception.observer import Observer, population, population_observer, read_observer, reference_observer
from tissue.perception.perceived import held_back
from tissue.scene.load import load_scene
from tissue.simulation.simulate import simulate
from tissue.system.owned_folder import owned_folder

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["perception_charts"]

PEOPLE, PERSON, WANTED, GREY = "#0072B2", "#D55E00", "0.25", "0.6"
DEVICE, SCENE = "touch", "wall"
EXAMPLE = Observer.known("example", alpha=0.7, beta=1.4, kappa=0.09, offset_N=0.25, lapse=0.02, sigma=0.2)
"""Somebody to draw where no observer is given: force grows less on this person than on the reference."""


def perception_charts(out: Path, observer: Path | None, *, overwrite: bool = False) -> list[Path]:
    """Draw all pictures of perception into a folder; of an observer's file, or of an example.

    Raises
    ------
    InputError
        If the observer's file cannot be used, or the folder is a file or holds such pictures.
    """
    someone = EXAMPLE if observer is None else read_observer(observer)
    drawn = {"people": _people, "command": _command, "deadband": _deadband, "estimate": _estimate}
    pictures = {f"perception-{name}.png": draw for name, draw in drawn.items()}
    with owned_folder(out, "chart", pictures, overwrite=overwrite):
        for name, draw in pictures.items():
            draw(someone, out / name)
    return [out / name for name in pictures]


def _people(someone: Observer, path: Path) -> None:
    """Intensity and threshold over force, of the population and of one observer."""
    chart = figure(10.0, 4.2)
    left, right = chart.subplots(1, 2)
    chart.subplots_adjust(left=0.075, right=0.985, top=0.93, bottom=0.13, wspace=0.22)
    forces = np.geomspace(0.1, 10.0, 200)
    for name, entry in constants("perception", "exponent").items():
        if name != "muscle_force":
            left.plot(forces, forces**entry.value, color=GREY, linewidth=0.8, linestyle=":")
            left.text(10.3, 10.0**entry.value, name.replace("_", " "), color="0.3", fontsize=9.5, va="center")
    for who, colour, label in ((population_observer(), PEOPLE, "population"), (someone, PERSON, someone.name)):
        law = intensity_of(who)
        mean, spread = law.expected(forces), law.spread(forces)
        left.fill_between(forces, np.maximum(mean - spread, 1e-4), mean + spread, color=colour, alpha=0.18, linewidth=0)
        left.plot(forces, mean, color=colour, linewidth=1.8, label=f"{label}: mean, ± 1 standard deviation")
    left.plot(forces, intensity_of(reference_observer()).expected(forces), "--", color=WANTED, label="reference")
    left.set(xscale="log", yscale="log", ylim=(0.01, 200.0), xlim=(0.1, 45.0))
    left.set(xlabel="force / N", ylabel="intensity / reference's at 1 N", title="how strong a force feels")
    drawn = population().draws(4000, np.random.default_rng(0))
    shares = 100.0 * drawn["kappa"] * (1.0 + drawn["offset_N"] / forces[:, None])
    low, high = np.quantile(shares, [0.1, 0.9], axis=1)
    right.fill_between(forces, low, high, color=PEOPLE, alpha=0.18, linewidth=0, label="eight in ten people")
    right.plot([2.5, 10.0], [7.0, 7.0], color="#009E73", linewidth=5, alpha=0.6, label="Pang et al. 1991")
    right.fill_between([0.1, 0.5], 10.0, 28.0, color="#E69F00", alpha=0.35, label="published below 0.5 N, uncertain")
    for who, colour, label in ((population_observer(), PEOPLE, "population"), (someone, PERSON, someone.name)):
        right.plot(forces, 100.0 * weber_of(who).threshold(forces) / forces, color=colour, label=label, linewidth=1.8)
    right.set(xscale="log", xlabel="force / N", ylabel="threshold / % of the force", ylim=(0.0, 46.0))
    right.set_title("the smallest change that is felt")
    _finish(chart, (left, right), path)


def _command(someone: Observer, path: Path) -> None:
    """Command over force, and what is felt of it."""
    limit_N = device_parameters(DEVICE).force_limit_N
    device, forces = ForceRange(limit_N=limit_N), np.geomspace(0.02, 3.0 * limit_N, 600)
    chart = figure(10.0, 4.2)
    left, right = chart.subplots(1, 2)
    chart.subplots_adjust(left=0.075, right=0.985, top=0.93, bottom=0.13, wspace=0.22)
    knee_N = device.knee_share * limit_N
    right.plot(forces, forces**1.7, "--", color=WANTED, label="wanted: reference, physical force")
    for who, colour in ((population_observer(), PEOPLE), (someone, PERSON)):
        law = perception_for(who, rng=np.random.default_rng(0), force_limit_N=limit_N, tick_s=1e-3).law
        commands = law.command_N(forces)
        played = np.array([device.play(np.array([force, 0.0, 0.0]))[0][0] for force in commands])
        left.plot(forces, commands, ":", color=colour, linewidth=1.2)
        left.plot(forces, played, color=colour, linewidth=1.8, label=f"{who.name}, gain {law.gain:.2f}")
        felt = intensity_of(who)
        unit = float(felt.expected(law.command_N(1.0)))
        right.plot(forces, felt.expected(played) / unit, color=colour, linewidth=1.8, label=f"{who.name}, commanded")
        plain = felt.expected(forces) / felt.expected(1.0)
        right.plot(forces, plain, color=colour, linewidth=1.0, linestyle="-.", label=f"{who.name}, physical force")
    left.plot(forces, forces, "--", color=WANTED, label="physical force")
    left.axhline(limit_N, color="0.3", linewidth=0.9)
    left.text(0.055, 1.05 * limit_N, f"limit of {DEVICE}", fontsize=9.5)
    for axes in (left, right):
        axes.axvline(knee_N, color=GREY, linewidth=0.9, linestyle="--")
        axes.set(xscale="log", yscale="log", xlabel="force at the device / N", xlim=(0.05, 10.0))
    left.set(ylabel="force played / N", ylim=(0.02, 8.0), title="command; dotted before the device's range")
    right.set(ylabel="intensity / that at 1 N", ylim=(0.005, 60.0), title="ratios survive up to the dashed knee")
    _finish(chart, (left, right), path)


def _deadband(someone: Observer, path: Path) -> None:
    """A recorded force as the deadband plays it."""
    run = simulate(load_scene(SCENE, {"device": DEVICE, "hand": "novice", "seed": 3}))
    wanted, time = run.trace.vectors("filtered_force", "N"), run.trace["time_s"]
    law = weber_of(someone, quantile=CAUTION)
    played, changed = held_back(wanted, law)
    size, shown = np.linalg.norm(wanted, axis=1), np.linalg.norm(played, axis=1)
    contact = size > law.kappa * law.offset
    saved = 100.0 * (1.0 - changed[contact].mean())
    off = np.linalg.norm(wanted - played, axis=1) / law.threshold(shown)
    chart = figure(10.0, 5.2)
    upper, lower = chart.subplots(2, 1, sharex=True, height_ratios=(2.2, 1.0))
    chart.subplots_adjust(left=0.075, right=0.985, top=0.93, bottom=0.1, hspace=0.08)
    upper.fill_between(time, shown - law.threshold(shown), shown + law.threshold(shown), color=PEOPLE, alpha=0.18,
                       linewidth=0, step="post", label="not felt as a change")  # fmt: skip
    upper.plot(time, size, color=WANTED, linewidth=1.0, label="wanted")
    upper.step(time, shown, color=PEOPLE, linewidth=1.6, where="post", label="played")
    upper.plot(time[changed], shown[changed], "o", color=PERSON, markersize=3.5, label="changes")
    upper.set(ylabel="force / N", ylim=(0.0, None))
    upper.set_title(f"{SCENE} by a novice, {someone.name}: {saved:.1f} % of the samples in contact are not needed")
    lower.plot(time, off, color=PEOPLE, linewidth=1.0)
    lower.axhline(1.0, color="0.3", linestyle="--", linewidth=1.0)
    lower.set(xlabel="time / s", ylabel="error / threshold", ylim=(0.0, 1.15))
    inside = time[contact]
    lower.set_xlim(inside[0] - 0.02, inside[-1] + 0.02)
    lower.grid(alpha=0.3)
    _finish(chart, (upper,), path)


def _estimate(someone: Observer, path: Path) -> None:
    """A posterior of two maxima, the estimate over the look, and what wrong assumptions cost."""
    chart = figure(13.0, 4.6)
    left, middle, right = (
        chart.add_axes((start, 0.12, width, 0.8)) for start, width in ((0.05, 0.22), (0.32, 0.215), (0.76, 0.23))
    )
    _two_maxima(left)
    looks = np.linspace(-1.0, 4.0, 400)
    for noise, colour in ((0.1, PEOPLE), (0.3, "#009E73"), (1.0, PERSON)):
        middle.plot(looks, map_force_N(looks, noise), color=colour, linewidth=1.8, label=f"noise {noise:g} N")
    middle.plot(looks, looks, "--", color=WANTED, linewidth=1.0, label="the look itself")
    middle.set(xlabel="what one look shows / N", ylabel="most probable force / N", ylim=(0.0, 4.0))
    middle.set_title("prior: median 1 N, ln F ± 1")
    rng = np.random.default_rng(0)
    rows = [*map_estimate_errors(rng), *recursive_estimate_errors(rng)]
    names = [
        f"{each.assumed}, {100 * each.held:.0f} % held" if each.held == each.held else each.assumed for each in rows
    ]
    split = next(k for k, each in enumerate(rows) if each.held == each.held)
    place = np.array([k + (0.8 if k >= split else 0.0) for k in range(len(rows))])
    colours = [PEOPLE if k < split else PERSON for k in range(len(rows))]
    right.barh(place, [each.error for each in rows], color=colours, height=0.75)
    right.axvline(1.0, color="0.3", linestyle="--", linewidth=1.0)
    right.set_yticks(place, names, fontsize=9)
    right.invert_yaxis()
    right.set(xlabel="error / noise of a look, or / right filter's", title="blue: one look, orange: recursion")
    right.grid(alpha=0.3, axis="x")
    _finish(chart, (left, middle), path)


def _two_maxima(axes: "Axes") -> None:
    """One look far above a narrow prior: the density has two maxima."""
    seen, spread, noise = 60.0, 0.3, 4.4
    force = np.geomspace(0.3, 100.0, 2000)
    one = np.ones_like(force)
    height = log_posterior(np.log(force), seen * one, noise * one, 0.0 * one, spread * one)
    axes.plot(force, height - height.max(), color=PEOPLE, linewidth=1.8, label="posterior")
    axes.plot(force, -0.5 * (np.log(force) / spread) ** 2 - np.log(force), "--", color=GREY, label="prior")
    axes.plot(force, -0.5 * ((seen - force) / noise) ** 2, ":", color=WANTED, label="likelihood")
    best = float(map_force_N(seen, noise, median_N=1.0, log_spread=spread))
    axes.plot(best, 0.0, "*", color=PERSON, markersize=14, label=f"estimate, {best:.3g} N")
    peaks = np.flatnonzero((np.diff(height)[:-1] > 0.0) & (np.diff(height)[1:] <= 0.0)) + 1
    other = [k for k in peaks if abs(np.log(force[k] / best)) > 0.1]
    axes.plot(force[other], (height - height.max())[other], "o", color=PERSON, fillstyle="none", markersize=9,
              label="lower maximum")  # fmt: skip
    axes.set(xscale="log", xlabel="force / N", ylabel="log density, shifted", ylim=(-22.0, 4.0))
    axes.set_title(f"look {seen:g} ± {noise:.2g} N, prior 1 N")


def _finish(chart: "Figure", panels: "tuple[Axes, ...]", path: Path) -> None:
    """Grids and legends, and the file."""
    for axes in panels:
        axes.grid(alpha=0.3, which="major")
        axes.legend(loc="best", fontsize=9.5)
    save(chart, path)
