"""Comparison of force rendering methods in many simulated trials: `tissue.study`.

The command `tissue study run` calls these functions.
"""

from pathlib import Path

from meshes.base.hints import suggests_arguments
from meshes.base.progress import Progress, silent
from tissue.evaluation.study.folder import StudyFolder, run_study
from tissue.evaluation.study.plan import Plan, TrialKey
from tissue.evaluation.study.trial import Trial, run_trial

__all__ = ["Plan", "StudyFolder", "Trial", "register", "run", "trial"]


@suggests_arguments
def register(plan: Plan, out: str | Path) -> StudyFolder:
    """Register a plan before its first trial.

    The function writes ``plan.toml``. The file contains the outcome measures, the statistical tests
    and their power, the rules for excluding trials, and the seeds.

    `run` registers the plan if it is not registered yet. A plan that was edited after registration
    is refused.

    Parameters
    ----------
    plan
        Plan of the study.
    out
        Folder of the study.

    Raises
    ------
    InputError
        If the folder holds another study, or the plan in the folder was edited after its
        registration.
    """
    folder = StudyFolder(Path(out))
    folder.begin(plan)
    return folder


@suggests_arguments
def run(
    plan: Plan,
    out: str | Path,
    *,
    workers: int | None = None,
    retry: bool = False,
    progress: Progress | None = None,
) -> StudyFolder:
    """Run the trials of a plan that are not yet in the folder of the study.

    The method ``table("T2")`` of the result returns the results of task T2.

    In a script, call this function under ``if __name__ == "__main__":``, because the worker
    processes import the script.

    Parameters
    ----------
    plan
        Plan of the study.
    out
        Folder of the study. If it contains trials of this study, only the other trials are run.
    workers
        Number of processes; default one per core. The results do not depend on this number.
    retry
        Whether to run failed trials again.
    progress
        Function that is called with the name of the current work and its completed share (0 to 1).

    Raises
    ------
    InputError
        If the folder holds another study, or worker processes crash repeatedly.
    """
    return run_study(plan, Path(out), workers=workers, retry=retry, report=progress or silent)


@suggests_arguments
def trial(plan: Plan, name: str) -> Trial:
    """Run one trial of a plan, with a result bit-identical to that in the whole study.

    Parameters
    ----------
    plan
        Plan of the study.
    name
        Name of the trial: task, group and number, such as ``T2-expert-0001``.

    Raises
    ------
    InputError
        If the plan does not contain this trial.
    """
    return run_trial(plan, TrialKey.named(name))
