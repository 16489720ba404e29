"""``tissue study plan``, ``tissue study run`` and ``tissue study report``."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from meshes.base.errors import counted
from tissue.cli.terminal import Flag, MaybeWhole, Whole, console, left_out, problems
from tissue.system.progress import progress

if TYPE_CHECKING:
    from tissue.evaluation.study.plan import Plan

study = App(
    name="study",
    help="Compare methods of force rendering in many simulated trials, and report the results.",
)
LINES_S = 60.0
"""Time between two printed lines of progress if the output is not a terminal [s]."""
Names = Annotated[tuple[str, ...], Parameter(negative="", consume_multiple=True)]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class PlanOptions:
    """Command-line options for the plan of a study.

    Attributes
    ----------
    trials
        Number of trials for each task and group. If an existing study has fewer trials, the missing
        trials are added.
    tasks
        Tasks: T1 (palpation), T2 (wall), T3 (milling), needle, reaming or drilling; default all.
    methods
        Methods of force rendering: penalty, energy, koopman, koopman-look-ahead, koopman-online,
        koopman-perception, or the name of a registered predictor. Default: all methods except
        registered predictors.
    groups
        Groups of simulated hands: novice, intermediate or expert; default all.
    seed
        Seed of all random draws.
    """

    trials: Whole = 100
    tasks: Names = ()
    methods: Names = ()
    groups: Names = ()
    seed: Whole = 0

    def plan(self) -> "Plan":
        """Return the study plan that these options describe.

        A value of an option may contain several names, separated by commas.
        """
        from tissue.evaluation.study.plan import Plan

        chosen = {"tasks": self.tasks, "methods": self.methods, "groups": self.groups}
        split = {
            name: tuple(each for word in words for each in word.split(",") if each)
            for name, words in chosen.items()
        }
        return Plan(
            seed=self.seed,
            trials=self.trials,
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
    """Run or continue a study; each trial is written to disk when it is complete.

    Before the first trial, the plan is registered in plan.toml. The plan contains the outcome
    measures, the statistical tests and their power, the rules for excluding trials, and the seeds.

    Parameters
    ----------
    workers
        Number of processes; default one per core.
    scheduler
        Run the trials on the workers of the Dask scheduler at tcp://HOST:PORT or tls://HOST:PORT.
    out
        Folder of the study; default studies/paper.
    retry
        Run failed trials again.
    only
        Name of a trial, such as T1-novice-0007. Only this trial is run, and its result is printed.
    """
    from tissue.evaluation.study.folder import StudyFolder, run_study
    from tissue.evaluation.study.plan import TrialKey
    from tissue.evaluation.study.trial import failures_of, run_trial

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
        problems.print(f"already run: {there} of {counted(len(wanted), 'trial')}")
    with progress(quiet_s=LINES_S) as bar:
        begun: float | None = None

        def report(doing: str, share: float) -> None:
            """Update the progress bar, and print messages that come before the first trial."""
            nonlocal begun
            if begun is None:
                begun = share
            bar(doing, share)
            if share == begun:
                problems.print(doing)

        folder = run_study(
            plan, out, workers=workers, scheduler=scheduler, retry=retry, report=report
        )
    kept = list(folder.trials())
    failed = sum(trial.failed for trial in kept)
    console.print(f"{counted(len(kept), 'trial')} in {out}, {failed} with a failure")
    for what, names in list(failures_of(kept).items())[:1]:
        console.print(f"first failure: {what} ({names[0]})")
    for task in plan.tasks:
        took = sorted(trial.took_s for trial in kept if trial.key.task == task)
        console.print(
            f"{task}: median of {took[len(took) // 2]:.1f} s for a trial with "
            f"{counted(len(plan.methods), 'method')}"
        )
    if any("failure" not in row for trial in kept for row in trial.rows):
        console.print(f"next: tissue study report {out}")


@study.command(name="plan")
def register_plan(*, options: PlanOptions = PlanOptions(), out: Path | None = None) -> None:
    """Write the plan of a study to plan.toml without running the study.

    `tissue study run` with the same options then uses this plan.

    Parameters
    ----------
    out
        Folder of the study; default studies/paper.
    """
    from tissue.evaluation.study.folder import StudyFolder
    from tissue.evaluation.study.registration import notes_before

    plan = options.plan()
    out = out or Path("studies/paper")
    folder = StudyFolder(out)
    with folder.held(plan):
        pass
    for note in notes_before(plan):
        problems.print(note)
    newest = folder.registrations()[-1]
    console.print(f"{out / str(newest['file'])}, SHA-256 {newest['sha256']}")
    console.print(f"next: tissue study run with the same options, --out {out}")


@study.command
def report(folder: Path, /) -> None:
    """Write tables, plots and their interpretation into the folder of a study.

    For comparison, the report also contains the results of the project's paper.

    Parameters
    ----------
    folder
        Folder of the study, written by `tissue study run`. For an unfinished study, the report uses
        the trials that are complete so far.
    """
    with progress() as report:
        from tissue.evaluation.study.report import write_report

        written, sentences = write_report(folder, report=report)
    console.print(*sentences, sep="\n")
    console.print(f"open {written}")
