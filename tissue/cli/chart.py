"""``tissue chart``."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from tissue.cli.terminal import Flag, MaybeWhole, console, left_out
from tissue.system.progress import progress

TRIALS = 30
"""Default number of test runs of each scene for predictors: ten runs for each simulated hand."""
TASKS = ("palpation", "wall", "milling")
"""Default scenes for the chart of predictors."""


def chart(
    *what: str,
    out: Path | None = None,
    quick: Flag = False,
    trials: MaybeWhole = None,
    predictor_file: Path | None = None,
    overwrite: Flag = False,
) -> None:
    """Measure and draw tick times and force errors of scenes, or errors of force predictors.

    Parameters
    ----------
    what
        Names of scenes or TOML files (default all built-in scenes), to draw tick time and force
        error of each scene for many settings. Or the word `prediction` followed by scenes (default
        palpation, wall and milling), to draw the errors of all guarded force predictors in runs
        that were not used for training.
    out
        Output folder; default charts or charts/prediction.
    quick
        Use fewer settings, shorter runs and a coarser reference solution. Not possible with the
        argument `prediction`.
    trials
        Only with prediction: number of test runs of each scene; default 30.
    predictor_file
        Only with `prediction` and one scene: file that `tissue train` wrote for this scene; default
        the file that the scene names, or the built-in file.
    overwrite
        Replace the charts that the folder already holds.
    """
    measure: Callable[..., Any]
    lines: Callable[[Any], list[str]]
    if what[:1] == ("prediction",):
        left_out("with prediction", "remove it", quick=quick)
        from tissue.evaluation.charts.prediction import (
            chart_prediction,
            comparison_lines,
            predictable,
        )
        from tissue.scene.load import load_scene

        folder = out or Path("charts/prediction")
        able, notes = predictable([load_scene(name) for name in what[1:] or TASKS], predictor_file)
        count = TRIALS if trials is None else trials
        measure = partial(chart_prediction, able, folder, trials=count, file=predictor_file)
        lines = comparison_lines
    else:
        left_out(
            "unless predictors are charted",
            "add prediction before the scenes, or remove this option",
            trials=trials,
            predictor_file=predictor_file,
        )
        from tissue.evaluation.charts.scenes import chart_lines, chart_scenes, notes_before

        folder = out or Path("charts")
        notes = notes_before(what)
        measure = partial(chart_scenes, what, folder, quick=quick)
        lines = chart_lines
    for note in notes:
        console.print(note)
    with progress() as report:
        found: Any = measure(overwrite=overwrite, report=report)
    console.print(*lines(found), sep="\n")
    console.print(f"pictures and tables in {folder}")
