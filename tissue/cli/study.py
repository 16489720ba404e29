"""``tissue study plan``, ``tissue study run`` and ``tissue study report``."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from tissue.cli.terminal import Flag, MaybeWhole, Whole, console, left_out, problems
from tissue.system.progress import progress

if TYPE_CHECKING:
    from tissue.evaluation.study.plan import Plan

__all__ = ["study"]


study = App(
    name="study",
    help="Compare methods of rendering force over many trials, and report what they show.",
)
LINES_S = 60.0
"""Time between two lines of progress without a terminal [s]: a study runs for an hour."""
Names = Annotated[tuple[str, ...], Parameter(negative="", consume_multiple=True)]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class PlanOptions:
    """Options of a study's plan.

    Attributes
    ----------
    trials
        Trials for each task and group; an existing study may be extended.
    tasks
        Some of T1 (palpation), T2 (wall), T3 (milling), needle, reaming, drilling; default all.
    methods
        Some of penalty, energy, koopman, koopman-look-ahead, koopman-online, koopman-perception;
        default all. Any other registered predictor is a method by its name.
    groups
        Some of novice, intermediate, expert; default all.
    sensitivity
        Also repeat a few trials with one parameter changed, and against the finest model.
    seed
        Seed of all random draws.
    """

    trials: Whole = 100
    tasks: Names = ()
    methods: Names = ()
    groups: Names = ()
    sensitivity: bool = True
    seed: Whole = 0

    def plan(self) -> "Plan":
        """Return the plan; names may be separated by commas."""
        from tissue.evaluation.study.plan import Plan

        chosen = {"tasks": self.tasks, "methods": self.methods, "groups": self.groups}
        split = {
            name: tuple(each for word in words for each in word.split(",") if each)
            for name, words in chosen.items()
        }
        return Plan(
            seed=self.seed,
            trials=self.trials,
            sensitivity=self.sensitivity,
            **{name: words for name, words in split.items() if words},
        )


@study.command
def run(
    *,
    options: PlanOptions = PlanOptions(),
    workers: MaybeWhole = None,
    scheduler: str | None = None,
    out: Path | None = None,
    retry: Flag = False,
    only: str | None = None,
) -> None:
    """Run or continue a study; every trial is written to disk as soon as it is done.

    The plan (measures, tests, exclusions, seeds, power) is registered in plan.toml before the first
    trial.

    Parameters
    ----------
    workers
        Processes; default one a core.
    scheduler
        tcp://HOST:PORT or tls://HOST:PORT: run on the workers of that Dask scheduler instead.
    out
        Folder of the study; default studies/paper.
    retry
        Run failed trials again.
    only
        Name of one trial, such as T1-novice-0007: run only this trial and print its result.
    """
    from tissue.evaluation.study.folder import StudyFolder, run_study
    from tissue.evaluation.study.plan import TrialKey
    from tissue.evaluation.study.trial import run_trial

    plan = options.plan()
    if only is not None:
        left_out(
            "with --only, which runs one trial here and writes no files",
            "remove it",
            workers=workers,
            scheduler=scheduler,
            out=out,
            retry=retry,
        )
        trial = run_trial(plan, TrialKey.named(only))
        console.print(f"{only}, seed {trial.seed}, {trial.took_s:.1f} s")
        for row in trial.rows:
            line = ", ".join(
                f"{name} {each if isinstance(each, str) else f'{each:.6g}'}"
                for name, each in row.items()
            )
            console.print(line)
        return
    out = out or Path("studies/paper")
    wanted = list(plan.all_trials())
    if there := sum(map(StudyFolder(out).has, wanted)):
        problems.print(f"{there} of {len(wanted)} trials are there, missing ones are run")
    with progress(quiet_s=LINES_S) as bar:

        def report(doing: str, share: float) -> None:
            """Move the bar, and print messages from before the first trial."""
            bar(doing, share)
            if share == 0.0:
                problems.print(doing)

        bar("starting workers", 0.0)
        folder = run_study(
            plan, out, workers=workers, scheduler=scheduler, retry=retry, report=report
        )
    kept = list(folder.trials(variant=None))
    failed = sum(trial.failed for trial in kept)
    console.print(f"{len(kept)} trials in {out}, {failed} with a failure")
    for task in plan.tasks:
        took = sorted(
            trial.took_s for trial in kept if trial.key.task == task and not trial.key.variant
        )
        console.print(
            f"{task}: {took[len(took) // 2]:.1f} s a trial of {len(plan.methods)} methods"
        )
    console.print(f"next: tissue study report {out}")


@study.command(name="plan")
def register_plan(*, options: PlanOptions = PlanOptions(), out: Path | None = None) -> None:
    """Register a study without running it: write its plan.toml.

    `tissue study run` with the same options then follows this plan.

    Parameters
    ----------
    out
        Folder of the study; default studies/paper.
    """
    from tissue.evaluation.study.folder import StudyFolder

    plan = options.plan()
    out = out or Path("studies/paper")
    folder = StudyFolder(out)
    with folder.held(plan):
        pass
    newest = folder.registrations()[-1]
    console.print(f"{out / str(newest['file'])}, SHA-256 {newest['sha256']}")
    console.print(f"next: tissue study run with the same options, --out {out}")


@study.command
def report(folder: Path, /, *, exploratory: Path | None = None) -> None:
    """Write tables, figures and their interpretation into a study's folder.

    The paper's figures are shown for comparison.

    Parameters
    ----------
    folder
        Folder that `tissue study run` wrote; an unfinished study is reported up to its present
        state.
    exploratory
        Folder of an older study. Its figures are printed next to those of the study and labelled
        exploratory.
    """
    with progress() as report:
        from tissue.evaluation.study.report import write_report

        written, sentences = write_report(folder, exploratory=exploratory, report=report)
    console.print(*sentences, sep="\n")
    console.print(f"open {written}")
