"""Comparison of force rendering methods over many simulated trials: `tissue.study`.

The command `tissue study run` does the same.
"""

from pathlib import Path

from meshes.base.progress import Progress, silent
from tissue.evaluation.study.folder import StudyFolder, run_study
from tissue.evaluation.study.plan import Plan, TrialKey
from tissue.evaluation.study.trial import Trial, run_trial

__all__ = ["Plan", "StudyFolder", "Trial", "register", "run", "trial"]


def register(plan: Plan, out: str | Path) -> StudyFolder:
    """Register a plan before its first trial.

    ``plan.toml`` holds measures, tests, exclusions, seeds and power.

    `run` registers the plan if this was not done. A plan that was edited since is refused.

    Parameters
    ----------
    plan
        Plan of the study.
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
    """Run the trials of a plan that its folder does not hold yet.

    ``.table("T2")`` of the result has the figures.

    Call it under ``if __name__ == "__main__":`` in a script, because its worker processes import
    the script.

    Parameters
    ----------
    plan
        Plan of the study.
    out
        Folder of the study; a study that is partly done is continued.
    workers
        Number of processes; default one a core. The figures do not depend on it.
    retry
        Whether to run failed trials again.
    progress
        Called with the present work and its completed share.

    Raises
    ------
    InputError
        If the folder holds another study, or workers are lost repeatedly.
    """
    return run_study(plan, Path(out), workers=workers, retry=retry, report=progress or silent)


def trial(plan: Plan, name: str) -> Trial:
    """Run one trial of a plan; its figures equal the study's to the last bit.

    Parameters
    ----------
    plan
        Plan of the study.
    name
        Name of the trial: task, group and number, such as ``T2-expert-0001``.

    Raises
    ------
    InputError
        If the plan can have no such trial.
    """
    return run_trial(plan, TrialKey.named(name))
