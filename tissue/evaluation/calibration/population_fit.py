"""A population from the logs of many sessions."""

from pathlib import Path

import numpy as np

from meshes.base.errors import InputError
from meshes.base.whole_file import whole_file
from tissue.evaluation.calibration.session import Session
from tissue.evaluation.calibration.trial_log import read_log
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
from tissue.system.outputs import require_new_file

__all__ = ["fit_population", "new_person", "pooled_trials"]


def pooled_trials(sessions: list[Session]) -> PopulationTrials:
    """Return the trials of many sessions, end to end."""
    compared = [
        (who, asked, answer) for who, each in enumerate(sessions) for asked, answer in each.asked
    ]
    numbers = [
        (who, force, number) for who, each in enumerate(sessions) for force, number in each.given
    ]
    return PopulationTrials(
        observers=len(sessions),
        who_compared=np.array([who for who, _, _ in compared], dtype=int),
        base_N=np.array([asked.base_N for _, asked, _ in compared]),
        step_N=np.array([asked.step_N for _, asked, _ in compared]),
        right=np.array([answer == asked.greater for _, asked, answer in compared], dtype=bool),
        who_rated=np.array([who for who, _, _ in numbers], dtype=int),
        force_N=np.array([force for _, force, _ in numbers]),
        number=np.array([number for _, _, number in numbers]),
    )


def new_person(fit: PopulationFit, *, trials: int, rng: np.random.Generator) -> Observer:
    """Return an observer for an unmeasured person of the population.

    The spread between people is included.
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
        "lapse": np.clip(
            lapses[np.arange(count), rng.integers(lapses.shape[1], size=count)], 1e-6, 0.5
        ),
        "sigma": np.sqrt(squared),
    }
    return Observer.from_draws("population", drawn, trials=trials)


def fit_population(
    folder: Path, out: Path, *, seed: int, overwrite: bool, progress: bool = False
) -> list[str]:
    """Fit the hierarchy to all logs in a folder, write the population and return sentences.

    The file describes an observer known only as a member of the population. A table next to it
    holds intervals and diagnostics of every parameter of the population. With ``progress`` every
    chain shows a bar.

    Raises
    ------
    InputError
        If the folder holds fewer than three logs with numbers and comparisons, a log cannot be
        read, or an output file exists and may not be replaced.
    """
    table = out.with_name(out.stem + ".table.csv")
    if out.suffix != ".json":
        raise InputError(
            "out", "be the name of a file that ends in .json", out, "use population.json"
        )
    for path in (out, table):
        require_new_file(path, overwrite=overwrite)
    if not folder.is_dir():
        raise InputError(
            "population", "be a folder of sessions", folder, "calibrate into one first"
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
    if len(sessions) < 3:
        raise InputError(
            "population",
            "hold three sessions or more with comparisons and numbers",
            f"{len(sessions)} in {folder}",
            "calibrate more people",
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
    with whole_file(table) as temporary:
        temporary.write_text(
            "\n".join(["parameter,low_95,median,high_95,r_hat,ess", *rows]) + "\n", "utf-8"
        )
    kappa = fit.interval("log_kappa")
    beta = fit.interval("beta")
    worst = max(fit.r_hat.values())
    least = min(fit.ess.values())
    return [
        f"{len(sessions)} observers: median Weber fraction {100 * np.exp(kappa[1]):.1f} % "
        f"(95 % within {100 * np.exp(kappa[0]):.1f} to {100 * np.exp(kappa[2]):.1f} %), "
        f"mean exponent {beta[1]:.2f} ({beta[0]:.2f} to {beta[2]:.2f})",
        f"convergence: R-hat at most {worst:.3f} (of {R_HAT}), effective sample size at "
        f"least {least:.0f} "
        f"(of {ESS:.0f}), {fit.divergences} divergences",
        *(f"note: {each}" for each in fit.problems()),
        *(f"note: {each} was left out: it holds no comparison or no number" for each in empty),
        f"wrote {out}, {table}",
    ]
