"""Statistics of a study: metrics of a trial, the table of trials, and tests that say what they rest on."""

from tissue.statistics.outcome import Assumption, Effect, Outcome
from tissue.statistics.trials import Cells, TrialTable

__all__ = ["Assumption", "Cells", "Effect", "Outcome", "TrialTable"]
