"""Display of a session: posterior of the threshold as text while it runs, and as a picture at
its end.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tissue.evaluation.calibration.session import Session
from tissue.perception.laws import D_PRIME_75, correct_of_d_prime, with_lapse
from tissue.show.figures.figure import figure, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from rich.panel import Panel

__all__ = ["draw_session", "posterior_panel"]

BLOCKS = " ▁▂▃▄▅▆▇█"
HEIGHT = 8
BLUE = "#0072B2"
ORANGE = "#E69F00"
GREY = "0.6"


def posterior_panel(session: Session) -> "Panel":
    """Return the posterior of the Weber fraction as bars of text, with the estimates under it."""
    from rich.panel import Panel

    masses = session.threshold.weber_masses()[:, 0]
    eighths = np.rint(8 * HEIGHT * masses / masses.max()).astype(int)
    rows = [
        "".join(BLOCKS[np.clip(each - 8 * row, 0, 8)] for each in eighths)
        for row in reversed(range(HEIGHT))
    ]
    webers = session.plan.prior.webers
    axis = [" "] * len(masses)
    for tick in (0.02, 0.05, 0.1, 0.2, 0.5):
        if webers[0] <= tick <= webers[-1]:
            at = int(np.argmin(np.abs(np.log(webers / tick))))
            word = f"{100 * tick:g}"
            axis[at : at + len(word)] = word
    text = "\n".join([*rows, "".join(axis)[: len(masses)] + " %", "", *session.lines()])
    count = session.plan.trials + session.plan.numbers
    return Panel(
        text,
        title=f"posterior of the Weber fraction, trial {session.trial} of {count}",
        expand=False,
    )


def draw_session(session: Session, path: Path) -> None:
    """Draw posterior, answers and numbers of a session into a PNG file."""
    chart = figure(13.0, 4.2)
    chart.set_layout_engine("constrained")
    left, middle, right = chart.subplots(1, 3)
    _posterior(session, left)
    _answers(session, middle)
    _numbers(session, right)
    save(chart, path)


def _posterior(session: Session, axes: "Axes") -> None:
    prior = session.plan.prior
    masses = prior.parameters()[3].reshape(prior.cells, -1).sum(axis=1)
    edges = 100.0 * prior.weber_edges
    axes.stairs(masses, edges, color=GREY, lw=1.5, label="prior")
    axes.stairs(
        session.threshold.weber_masses()[:, 0],
        edges,
        color=BLUE,
        fill=True,
        alpha=0.6,
        label="posterior",
    )
    for quantile in session.threshold.weber_quantiles(np.array([0.025, 0.975]))[:, 0]:
        axes.axvline(100.0 * quantile, color=BLUE, ls="--", lw=1.2)
    axes.set_xscale("log")
    ticks = [tick for tick in (2.0, 5.0, 10.0, 20.0, 50.0) if edges[0] <= tick <= edges[-1]]
    _ticks(axes, ticks)
    axes.set(
        xlabel="Weber fraction / %",
        ylabel="mass of a cell",
        title="Threshold, 95 % between the dashes",
    )
    axes.legend()


def _answers(session: Session, axes: "Axes") -> None:
    """Draw the shares of right answers over the step in thresholds, in bins of equal count."""
    weber, offset, lapse = (
        float(get()[0])
        for get in (
            lambda: session.threshold.weber()[0],
            session.threshold.offset_N,
            session.threshold.lapse,
        )
    )
    steps = np.array(
        [asked.step_N / (weber * (asked.base_N + offset)) for asked, _ in session.asked]
    )
    right = np.array([answer == asked.greater for asked, answer in session.asked])
    order = np.argsort(steps, kind="stable")
    for bin_ in np.array_split(order, max(min(8, len(order) // 6), 1)):
        if len(bin_):
            axes.semilogx(
                steps[bin_].mean(),
                100.0 * right[bin_].mean(),
                "o",
                color=ORANGE,
                ms=3.0 + np.sqrt(len(bin_)),
            )
    at = np.geomspace(0.1, max(steps.max(initial=5.0), 5.0), 200)
    share = with_lapse(2.0 * correct_of_d_prime(D_PRIME_75 * at) - 1.0, lapse)
    axes.semilogx(at, 100.0 * share, color=BLUE)
    _ticks(axes, [0.1, 0.3, 1, 3, 10])
    axes.axhline(75.0, color=GREY, lw=1.0, ls=":")
    axes.set(
        xlabel="step / threshold",
        ylabel="right answers / %",
        ylim=(35.0, 103.0),
        title="Answers and fitted function",
    )


def _numbers(session: Session, axes: "Axes") -> None:
    if not session.given:
        axes.text(0.5, 0.5, "no numbers were asked", ha="center", transform=axes.transAxes)
        axes.set_axis_off()
        return
    fit = session.magnitudes()
    (forces, numbers) = np.array(session.given).T
    at = np.geomspace(forces.min(), forces.max(), 50)
    axes.loglog(forces, numbers, "o", color=ORANGE, alpha=0.7)
    axes.loglog(at, np.exp(fit.mean[0]) * at ** fit.mean[1], color=BLUE)
    _ticks(axes, [0.3, 0.5, 1, 2, 3])
    axes.set(
        xlabel="force / N", ylabel="number given", title=f"Stevens' exponent {fit.mean[1]:.2f}"
    )
    axes.grid(alpha=0.3, which="both")


def _ticks(axes: "Axes", ticks: list[float]) -> None:
    """Set the ticks of a logarithmic axis."""
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xticks([], minor=True)
