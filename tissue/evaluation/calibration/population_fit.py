"""Fit of a population of observers to the logs of many calibration sessions."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from meshes.base.errors import InputError, counted
from meshes.base.whole_file import require_new_file, write_text
from tissue.evaluation.calibration.session import Session, read_log
from tissue.perception.hierarchy import (
    ESS,
    HYPER,
    R_HAT,
    VARIANCE_SHAPE,
    PopulationFit,
    PopulationTrials,
    fit_hierarchy,
)
from tissue.perception.observer import Observer, write_observer
from tissue.show.figures.figure import figure, save


def pooled_trials(sessions: list[Session]) -> PopulationTrials:
    """Return the trials of all sessions as arrays."""
    compared = [
        (who, asked.base_N, asked.step_N, answer == asked.greater)
        for who, each in enumerate(sessions)
        for asked, answer in each.asked
    ]
    numbers = [
        (who, force, number) for who, each in enumerate(sessions) for force, number in each.given
    ]
    return PopulationTrials(len(sessions), np.array(compared), np.array(numbers))


def new_person(fit: PopulationFit, *, trials: int, rng: np.random.Generator) -> Observer:
    """Return an observer with the parameter distribution predicted for an unmeasured person.

    The distribution includes the spread between the people of the population. `trials` is the
    number of trials to which the population was fitted.
    """
    flat = {name: fit.draws[name].ravel() for name in HYPER}
    count = len(flat["beta"])

    def person(name: str) -> np.ndarray:
        return flat[name] + flat[f"{name}_spread"] * rng.standard_normal(count)

    squared = (VARIANCE_SHAPE - 1.0) * flat["variance"] / rng.gamma(VARIANCE_SHAPE, size=count)
    lapses = fit.draws["lapse"].reshape(count, -1)
    drawn = {
        "alpha": np.exp(person("log_alpha")),
        "beta": person("beta"),
        "kappa": np.exp(person("log_kappa")),
        "offset_N": np.exp(person("log_offset")),
        # logarithm and logit of a lapse must be finite, and 0.5 is an answer without any attention
        "lapse": np.clip(
            lapses[np.arange(count), rng.integers(lapses.shape[1], size=count)], 1e-6, 0.5
        ),
        "sigma": np.sqrt(squared),
    }
    return Observer.from_draws("population", drawn, trials=trials)


def fit_population(
    folder: Path, out: Path, *, seed: int, overwrite: bool, progress: bool = False
) -> list[str]:
    """Fit the hierarchical model to all trial logs in a folder, and write the fitted population.

    The observer written to `out` has the parameter distribution predicted for an unmeasured person.
    A table next to this file contains, for every parameter of the population, the interval and the
    convergence diagnostics. The returned sentences describe the result of the fit. With
    ``progress``, every Markov chain shows a progress bar.

    Raises
    ------
    InputError
        If fewer than three logs in the folder contain both ratings and comparisons, a log cannot be
        read, or an output file exists and `overwrite` is false.
    """
    table = out.with_name(out.stem + ".table.csv")
    if out.suffix != ".json":
        raise InputError("out", "end in .json", out, "use population.json")
    for path in (out, table):
        require_new_file(path, overwrite=overwrite)
    if not folder.is_dir():
        raise InputError(
            "population",
            "be an existing folder of sessions",
            folder,
            "record sessions with `tissue calibrate` first",
        )
    paths = sorted(folder.glob("*.trials.jsonl"))
    empty = []
    sessions = []
    for path in paths:
        _, session = read_log(path)
        if session.asked and session.given:
            sessions.append(session)
        else:
            empty.append(path.name)
    # two people do not determine a spread between people
    if len(sessions) < 3:
        raise InputError(
            "population",
            "contain at least three sessions with comparisons and numbers",
            f"{len(sessions)} in {folder}",
            "record sessions of more people with `tissue calibrate`",
        )
    fit = fit_hierarchy(pooled_trials(sessions), seed=seed, progress=progress)
    person = new_person(
        fit, trials=sum(each.trial for each in sessions), rng=np.random.default_rng(seed)
    )
    write_observer(person, out, overwrite=overwrite)
    rows = [
        ",".join(
            [
                name,
                *(
                    f"{value:.6g}"
                    for value in (*fit.interval(name), fit.r_hat[name], fit.ess[name])
                ),
            ]
        )
        for name in HYPER
    ]
    write_text(table, "\n".join(["parameter,low_95,median,high_95,r_hat,ess", *rows]) + "\n")
    kappa = fit.interval("log_kappa")
    beta = fit.interval("beta")
    worst = max(fit.r_hat.values())
    least = min(fit.ess.values())
    return [
        f"{counted(len(sessions), 'observer')}: median Weber fraction "
        f"{100 * np.exp(kappa[1]):.1f} % "
        f"(95 % within {100 * np.exp(kappa[0]):.1f} to {100 * np.exp(kappa[2]):.1f} %), "
        f"mean exponent {beta[1]:.2f} ({beta[0]:.2f} to {beta[2]:.2f})",
        f"convergence: R-hat at most {worst:.3f} (of {R_HAT}), effective sample size at "
        f"least {least:.0f} "
        f"(of {ESS:.0f}), {counted(fit.divergences, 'divergence')}",
        *(f"note: {each}" for each in fit.problems()),
        *(f"note: {each} was left out: it holds no comparison or no number" for each in empty),
        f"wrote {out}, {table}",
    ]


BLUE = "#0072B2"
ORANGE = "#E69F00"
GREY = "0.6"


def draw_session(session: Session, path: Path) -> None:
    """Draw the posterior and the rated numbers of a session into a PNG file."""
    # inches: two panels side by side
    chart = figure(9.0, 4.2)
    chart.set_layout_engine("constrained")
    left, right = chart.subplots(1, 2)
    _posterior(session, left)
    _numbers(session, right)
    save(chart, path)


def _posterior(session: Session, axes: Axes) -> None:
    prior = session.plan.prior
    masses = prior.parameters()[3].reshape(prior.cells, -1).sum(axis=1)
    edges = 100.0 * prior.weber_edges
    axes.stairs(masses, edges, color=GREY, label="prior")
    axes.stairs(
        session.threshold.weber_masses()[:, 0],
        edges,
        color=BLUE,
        fill=True,
        alpha=0.6,
        label="posterior",
    )
    # 2.5 to 97.5 %: the 95 % interval
    for quantile in session.threshold.weber_quantiles(np.array([0.025, 0.975]))[:, 0]:
        axes.axvline(100.0 * quantile, color=BLUE, ls="--")
    axes.set_xscale("log")
    # 1, 2 and 5 of each decade, within the range of the prior
    ticks = [tick for tick in (2.0, 5.0, 10.0, 20.0, 50.0) if edges[0] <= tick <= edges[-1]]
    _ticks(axes, ticks)
    axes.set(
        xlabel="Weber fraction / %",
        ylabel="mass of a cell",
        title="Threshold, 95 % between the dashes",
    )
    axes.legend()


def _numbers(session: Session, axes: Axes) -> None:
    if not session.given:
        axes.text(0.5, 0.5, "no numbers were asked", ha="center", transform=axes.transAxes)
        axes.set_axis_off()
        return
    fit = session.magnitudes()
    (forces, numbers) = np.array(session.given).T
    # a straight line on both logarithmic axes
    at = np.geomspace(forces.min(), forces.max(), 50)
    axes.loglog(forces, numbers, "o", color=ORANGE, alpha=0.7)
    axes.loglog(at, np.exp(fit.mean[0]) * at ** fit.mean[1], color=BLUE)
    # the range of `MAGNITUDE_FORCES_N`
    _ticks(axes, [0.3, 0.5, 1, 2, 3])
    axes.set(
        xlabel="force / N", ylabel="number given", title=f"Stevens' exponent {fit.mean[1]:.2f}"
    )
    axes.grid(alpha=0.3, which="both")


def _ticks(axes: Axes, ticks: list[float]) -> None:
    """Set the tick marks of a logarithmic x axis."""
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xticks([], minor=True)
