"""``tissue chart``."""

from pathlib import Path

from meshes.base.errors import InputError
from tissue.cli.terminal import Flag, MaybeWhole, console, left_out
from tissue.system.progress import progress

__all__ = ["chart"]


TRIALS = 30
"""Default number of runs of each scene for the test of predictors: ten runs for each hand."""
TASKS = ("palpation", "wall", "milling")
"""Scenes of the tasks T1 to T3 of the study."""


def chart(
    *what: str,
    out: Path | None = None,
    quick: Flag = False,
    trials: MaybeWhole = None,
    observer: Path | None = None,
    overwrite: Flag = False,
) -> None:
    """Measure and draw the speed and accuracy of scenes, the errors of predictors, or perception.

    Parameters
    ----------
    what
        Names of built-in scenes (default all): draw tick time and force error of many settings.
        With `prediction`, followed by names of scenes (default palpation, wall and milling): draw
        the errors of all predictors on runs that were not used for training. With `perception`:
        draw intensity, threshold and perceptual maps.
    out
        Output folder; default charts, charts/prediction or charts/perception.
    quick
        With scenes: use fewer settings, shorter parts of the scenes and a coarser reference. Not
        possible with prediction or perception.
    trials
        Only with prediction: number of test runs of each scene; default 30.
    observer
        Only with perception: file of a person, written by `tissue calibrate`, to draw next to the
        population.
    overwrite
        Replace the charts that the folder already holds.
    """
    match what:
        case ["prediction", *scenes]:
            left_out("with prediction", "remove it", quick=quick, observer=observer)
            folder = out or Path("charts/prediction")
            runs = TRIALS if trials is None else trials
            _prediction(scenes or list(TASKS), folder, trials=runs, overwrite=overwrite)
        case ["perception"]:
            left_out("with perception", "remove it", quick=quick, trials=trials)
            _perception(out or Path("charts/perception"), observer, overwrite=overwrite)
        case ["perception", scene, *_]:
            raise InputError(
                "perception",
                "be given without scenes",
                f"{scene} after perception",
                f"leave {scene} out",
            )
        case _:
            left_out(
                "unless predictors are charted",
                "add prediction before the scenes, or remove it",
                trials=trials,
            )
            left_out(
                "unless perception is charted",
                "name perception in place of scenes, or remove it",
                observer=observer,
            )
            _scenes(list(what), out or Path("charts"), quick=quick, overwrite=overwrite)


def _scenes(names: list[str], folder: Path, *, quick: bool, overwrite: bool) -> None:
    """Run `tissue chart [SCENE ...]`."""
    from tissue.evaluation.charts.scenes import chart_lines, chart_scenes, notes_before

    for note in notes_before(names):
        console.print(note)
    with progress() as report:
        found = chart_scenes(names, folder, quick=quick, overwrite=overwrite, report=report)
    console.print(*chart_lines(found), sep="\n")
    console.print(f"pictures and tables in {folder}")


def _prediction(scenes: list[str], folder: Path, *, trials: int, overwrite: bool) -> None:
    """Run `tissue chart prediction`."""
    from tissue.evaluation.charts.prediction import chart_prediction, comparison_lines, predictable
    from tissue.scene.load import load_scene

    able, notes = predictable([load_scene(name) for name in scenes])
    for note in notes:
        console.print(note)
    with progress() as report:
        found = chart_prediction(able, folder, trials=trials, overwrite=overwrite, report=report)
    console.print(*comparison_lines(found), sep="\n")
    console.print(f"pictures and tables in {folder}")


def _perception(folder: Path, observer: Path | None, *, overwrite: bool) -> None:
    """Run `tissue chart perception`."""
    from tissue.evaluation.charts.perception import perception_charts

    drawn = perception_charts(folder, observer, overwrite=overwrite)
    for path in drawn:
        console.print(f"{path}")
