"""The whole evaluation by one command: tasks, groups and methods over many trials, and what they show."""

from tissue.study.folder import StudyFolder
from tissue.study.plan import Plan, TrialKey
from tissue.study.runner import run_study
from tissue.study.tasks import METHODS, TASKS
from tissue.study.trial import run_trial

__all__ = ["METHODS", "TASKS", "Plan", "StudyFolder", "TrialKey", "run_study", "run_trial"]
