"""Methods of rendering force compared over many simulated trials, as `tissue study run` does:
`tissue.study`.
"""

from pathlib import Path

from meshes.base.progress import Progress, silent
from tissue.evaluation.study.folder import StudyFolder
from tissue.evaluation.study.plan import Plan, TrialKey
from tissue.evaluation.study.runner import run_study
from tissue.evaluation.study.trial import Trial, run_trial

__all__ = ["Plan", "StudyFolder", "Trial", "register", "run", "trial"]


def register(plan: Plan, out: str | Path) -> StudyFolder:
    """Register a plan before its first trial: ``plan.toml`` with measures, tests, exclusions, seeds
    and power.

    `run` does so too where it was not done; a plan that was edited since is refused.

    Parameters
    ----------
    plan
        What is to be run.
    out
        Folder of the study.

    Raises
    ------
    InputError
        If the folder holds another study, or a plan that was edited.
    """
    folder = StudyFolder(Path(out))
    folder.begin(plan)
    return folder


def run(
    plan: Plan,
    out: str | Path,
    *,
    workers: int | None = None,
    retry: bool = False,
    progress: Progress | None = None,
) -> StudyFolder:
    """Run the trials of a plan that its folder does not hold yet; ``.table("T2")`` of what is
    returned has the figures.

    A script calls it under ``if __name__ == "__main__":``, for its worker processes import the
    script.

    Parameters
    ----------
    plan
        What to run.
    out
        Folder of the study; one that holds a part of it is gone on with.
    workers
        Processes; default one a core. The figures do not depend on it.
    retry
        Run trials that failed again.
    progress
        Called with how far it is.

    Raises
    ------
    InputError
        If the folder holds another study, or workers are lost again and again.
    """
    return run_study(plan, Path(out), workers=workers, retry=retry, report=progress or silent)


def trial(plan: Plan, name: str) -> Trial:
    """Run one trial of a plan alone; its figures are those of the study to the last bit.

    Parameters
    ----------
    plan
        The study's.
    name
        Name of the trial: task, group and number, such as ``T2-expert-0001``.

    Raises
    ------
    InputError
        If there can be no such trial.
    """
    return run_trial(plan, TrialKey.named(name))
