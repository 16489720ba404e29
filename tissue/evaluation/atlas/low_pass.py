"""E3: the filter's parameter is a time constant, not a cutoff, and its step must be the exact one."""

from math import pi, sqrt

import numpy as np
from matplotlib.figure import Figure

from tissue.evaluation.atlas.drawing import BLUE, GREY, RED, panel
from tissue.evaluation.atlas.page import Answer, Data, Page, Verdict, refused, shown, sweep
from tissue.haptics.loop.filters import LowPass, cutoff_Hz, low_pass_gain

__all__ = ["PAGE"]

CONSTANT_S = 5e-3
"""The time constant of the sweep [s]."""
STEPS = 200
"""Steps of a step response: an explicit one that runs away has done so by then."""


def amplitude(frequency_Hz: float) -> float:
    """Steady amplitude for a sine of amplitude 1, by running the filter at 400 steps a period."""
    step = 1.0 / (400.0 * frequency_Hz)
    low_pass = LowPass(CONSTANT_S, step_s=step, size=1)
    steps_run = round(6.0 * CONSTANT_S / step) + 400
    wave = np.sin(2.0 * pi * frequency_Hz * step * np.arange(steps_run))
    found = np.array([low_pass.step(value)[0] for value in wave[:, None]])
    return float(np.abs(found[-400:]).max())


def step_errors(share: float) -> dict[str, float]:
    """What differs from e^(-n T / a), which an exact response has left, after 200 steps of so many time constants."""
    low_pass, naive = LowPass(CONSTANT_S, step_s=share * CONSTANT_S, size=1), 0.0
    for _ in range(STEPS):
        reached = low_pass.step(np.ones(1))[0]
        naive += share * (1.0 - naive)
    left = np.exp(-STEPS * share)
    return {"exact_error": abs(1.0 - reached - left), "explicit_error": abs(1.0 - naive - left)}


def measure(quick: bool) -> Data:
    """Amplitude over frequency, and what a step response has left after 200 steps over the step's length."""
    # At 400 steps a period a time of 6 a takes 2400 a f steps: frequencies beyond 1 kHz would only repeat the line.
    frequency = np.geomspace(1.0, 500.0, 7 if quick else 19)
    ratio = np.concatenate([np.geomspace(0.05, 1.9, 6 if quick else 14), [1.98, 2.02], np.geomspace(2.1, 20.0, 5)])
    return {
        "amplitude": {
            "frequency_hz": frequency,
            "measured": np.array([amplitude(f) for f in frequency.tolist()]),
            "time_constant": 1.0 / np.sqrt(1.0 + (2.0 * pi * frequency * CONSTANT_S) ** 2),
            "printed_cutoff": 1.0 / np.sqrt(1.0 + (frequency / CONSTANT_S) ** 2),
        },
        "step": sweep("step_over_constant", ratio, step_errors),
    }


def judge(data: Data) -> Verdict:
    """The measured cutoff against 1 / (2 pi a) and against a; where the explicit step runs away against T = 2 a."""
    swept, stepped = data["amplitude"], data["step"]
    found = float(np.exp(np.interp(-sqrt(0.5), -swept["measured"], np.log(swept["frequency_hz"]))))
    runs_away = float(stepped["step_over_constant"][stepped["explicit_error"] > 1.0].min(initial=np.inf))
    worst, true = float(stepped["exact_error"].max()), cutoff_Hz(CONSTANT_S)
    return Verdict(
        bool(swept["measured"].min() < sqrt(0.5) and found > 100.0 * CONSTANT_S and 2.0 < runs_away < 2.05),
        abs(found / true - 1.0) < 0.1 and worst < 1e-12,  # 10 %: read between two frequencies of the coarser sweep
        f"The amplitude falls to 1/√2 at {found:.1f} Hz where 1/(2πα) is {true:.1f} Hz; read as a cutoff, α = "
        f"{CONSTANT_S:g} would have put it at {CONSTANT_S:g} Hz. The explicit step runs away from T = {runs_away:.2f} "
        f"α on (theory 2 α); the exact one is off by {worst:.0e} at most.",
    )


def ask() -> list[Answer]:
    """The engine's filter at its ends."""
    long = LowPass(CONSTANT_S, step_s=1.0, size=1).step(np.ones(1))[0]
    return [
        refused("a negative time constant", lambda: low_pass_gain(-1e-3, 1e-3)),
        refused("a step that is not a number", lambda: low_pass_gain(CONSTANT_S, float("nan"))),
        shown("no filter, α = 0", low_pass_gain(0.0, 1e-3) == 1.0, "the input passes unchanged"),
        shown("a step of 200 α", abs(long - 1.0) < 1e-12, f"the output is the input, {long:g} of 1"),
    ]


def draw(data: Data, chart: Figure) -> None:
    """Amplitude over frequency; error over the step."""
    left, right = chart.subplots(1, 2)
    swept, stepped = data["amplitude"], data["step"]
    left.axvline(cutoff_Hz(CONSTANT_S), color=GREY, linestyle=":")
    panel(left, swept["frequency_hz"], "frequency / Hz", "amplitude", [
        ("α as a time: 1/√(1+(2πfα)²)", swept["time_constant"], "-", GREY),
        ("α as a cutoff in Hz (printed)", swept["printed_cutoff"], "--", RED),
        ("measured", swept["measured"], "o", BLUE),
    ], title="α = 5 ms", legend="lower left")  # fmt: skip
    right.axvline(2.0, color=GREY, label="theory: T = 2α")
    panel(right, stepped["step_over_constant"], "step / time constant", "error after 200 steps", [
        ("explicit step", np.clip(stepped["explicit_error"], 1e-17, 1e12), "s", RED),
        ("exact step (ours)", np.clip(stepped["exact_error"], 1e-17, 1e12), "o", BLUE),
    ], title="step response")  # fmt: skip


PAGE = Page(
    "low_pass",
    "E3 · Is α of 1/(1+αs) a cutoff frequency?",
    "A published framework calls α the cutoff frequency of its low-pass. Which frequency does the filter cut, and up "
    "to which step may it be discretised by an explicit step?",
    "Statement E3; exact step y += (1 − e^(−T/α))(u − y)",
    measure,
    judge,
    ask,
    draw,
)
