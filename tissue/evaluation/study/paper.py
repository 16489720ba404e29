"""Figures of the paper that a study is compared with, and what was chosen after results had been seen."""

from dataclasses import dataclass

__all__ = ["CASES", "CHOSEN_AFTER", "COMPOSITE", "FORCE_ERROR", "LATENCY", "SOURCE", "TASK_METRICS", "Figure"]

SOURCE = (
    "A Koopman-Bayesian Framework for High-Fidelity, Perceptually Optimized Haptic Surgical Simulation, "
    "N = 900 trials (3 tasks x 3 expertise groups x 100)"
)
CHOSEN_AFTER = (
    "the needle is pushed by a rising force and stopped by a reaction, where a first study turned it round at a depth "
    "of its script",
    "what of a run counts as its error of force acts at the motor, where earlier studies took the force before it",
    "ratios of intensity are taken in windows that lie in contact whole, where a study of 180 trials took those half "
    "in contact too",
    "a puncture that nobody notices counts as the longest travel and a push ends at a depth of 60 mm, where a study of "
    "180 trials left such trials out",
    "hands aim below the bone in T3 and in reaming, so that they mill and ream it, where those of a study of 180 "
    "trials aimed at the wanted depth and skimmed it",
)
"""Choices of the study itself that were made with figures of an earlier version in sight; no others are known."""


@dataclass(frozen=True)
class Figure:
    """A published mean with its standard deviation, zero where none is given."""

    mean: float
    spread: float = 0.0

    def __str__(self) -> str:
        return f"{self.mean:g} ± {self.spread:g}" if self.spread else f"{self.mean:g}"


FORCE_ERROR = {
    "T1": {"penalty": Figure(8.2, 2.1), "koopman": Figure(3.5, 1.0), "koopman-perception": Figure(2.1, 0.7)},
    "T2": {"penalty": Figure(7.1, 1.8), "koopman": Figure(3.0, 0.9), "koopman-perception": Figure(1.8, 0.6)},
    "T3": {"penalty": Figure(9.5, 2.4), "koopman": Figure(4.2, 1.2), "koopman-perception": Figure(2.8, 0.8)},
}
"""Normalised L2 error of force [%]; the paper's columns are raw, Koopman-adjusted and perceptual."""
TASK_METRICS = {
    "T1": {"time_s": Figure(14.2, 1.8), "position_error_mm": Figure(0.71, 0.12), "smoothness": Figure(0.92, 0.03)},
    "T2": {"time_s": Figure(12.5, 1.2), "position_error_mm": Figure(0.63, 0.10), "smoothness": Figure(0.95, 0.02)},
    "T3": {"time_s": Figure(18.3, 2.1), "position_error_mm": Figure(0.85, 0.15), "smoothness": Figure(0.88, 0.04)},
}
"""Completion time [s], position error [mm] and an index of smoothness that is printed as if higher were better."""
LATENCY = Figure(4.3)
"""Mean latency [ms]."""
COMPOSITE = {"penalty": Figure(0.72, 0.05), "koopman-perception": Figure(0.91, 0.03)}
"""Composite index."""
CASES = {
    "overshoot_penalty_mm": Figure(1.34, 0.21),
    "overshoot_koopman_mm": Figure(0.92, 0.15),
    "reaming_rms_N": Figure(2.5),
    "reaming_position_mm": Figure(0.1),
    "torque_step_Nm": Figure(0.08),
    "caries_right_percent": Figure(92.0),
    "drilling_latency_ms": Figure(4.5),
}
"""Case studies; errors of reaming and the latency are upper bounds."""
