"""Tremor of a user's hand, estimated from position and force of a haptic device."""

from dataclasses import dataclass
from math import log, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.haptics.device.device import DeviceParameters
from tissue.haptics.hand.hand import HandParameters, hand_parameters
from tissue.materials.scene_constants import Materials
from tissue.models.tissue_model import TICK_S

Spectrum = NDArray[np.complex128]
BAND_HZ = 8.0, 12.0
"""Band of physiological tremor [Hz]; see `tremor_Hz` and `tremor_width_Hz` in hands.toml."""
SMOOTH_HZ = 40.0
"""Cut-off [Hz] of a low-pass filter on the velocity that the friction model uses.

The cut-off is above the tremor band.
"""
STICKS_M_S = 0.05
"""Speed below which the friction of the device is modelled as viscous [m/s].

While a device sticks, its friction is not known; it is at most the Coulomb friction. The speed was
chosen between 0.005 and 0.1 m/s with `python tests/bench/bench_assessment.py --sticks`. With 0.005
m/s, the computed tremor is twice as large in slow scenes, on a device with 0.26 N of friction.
"""
WINDOW_S = 0.25
"""Duration [s] of the windows over which the tremor is averaged: 2 to 3 tremor periods."""
QUANTILE = 0.75
"""Quantile of the tremor over all time windows that is reported as the tremor of the run.

The mean would depend too much on a few windows with an impact, and the median on windows in which
the device sticks.
"""
PAD_S = 0.5
"""Time [s] by which a signal is extended at both ends before it is filtered."""
LEAST_WINDOWS = 4
PATH_HZ = 4.0
"""Cut-off [Hz] of the low-pass filter that separates voluntary motion from tremor.

The cut-off is below the tremor band.
"""
DRAWS = 1000
"""Number of random draws of the tremor in each window, for the interval of the score."""
LEAST_MM = 1e-4
"""Smallest tremor with which a score is computed [mm], far below the tremor of a hand.

The score of zero tremor would be infinite.
"""
TYPICAL = "intermediate"
"""Expertise group whose grip is assumed, because the grip of the assessed person is unknown."""
NOVICE, EXPERT = "novice", "expert"
SCALE = "0 is the tremor of a novice's hand alone, and 100 is the tremor of an expert's hand alone"
"""Explanation of the score's scale in printed results."""


@dataclass(frozen=True)
class Steadiness:
    """Tremor of a hand, and its score.

    Attributes
    ----------
    tremor_mm
        Root mean square [mm], over all three axes, of the intended hand motion in the band from 8
        to 12 Hz. It is computed in time windows; the value is the quantile `QUANTILE` over these
        windows.
    score
        Score of the tremor: 0 for a novice's tremor and 100 for an expert's, as given by the
        constants in hands.toml. The score is linear in the logarithm of the tremor, and may be
        below 0 or above 100. Only runs of the same task with equal motion and force scales are
        comparable.
    low, high
        Ends of the 95 % interval of the score, computed by random draws of each window's tremor.
    """

    tremor_mm: float
    score: float
    low: float
    high: float


def steadiness(
    position_m: Array,
    force_N: Array,
    device: DeviceParameters,
    *,
    constants: Materials = Materials.cited,
    scored: int | None = None,
) -> Steadiness:
    """Estimate the tremor of the hand on a device.

    Parameters
    ----------
    position_m, force_N
        Measured position of the device [m] and force that the device applied [N], with a row for
        each tick of 1 ms, shape (n, 3).
    device
        Inertia, damping and friction of the device.
    constants
        Constants of the hands, which define the assumed grip and the scale of the score.
    scored
        Number of ticks, counted from the start of the run, in which the tremor is rated. Default:
        all ticks. At least the first second is rated.

    Raises
    ------
    InputError
        If the run is too short, or the device moved too slowly: friction then hides the tremor,
        because the device stops and reverses in every period of the tremor.
    """
    ticks = round(WINDOW_S / TICK_S)
    if scored is not None:
        scored = max(scored, LEAST_WINDOWS * ticks)
    count = len(position_m[:scored]) // ticks
    if count < LEAST_WINDOWS:
        raise InputError(
            "run",
            f"last at least {LEAST_WINDOWS * WINDOW_S:g} s",
            f"{len(position_m) * TICK_S:g} s",
            "record a longer run",
        )
    _require_motion(position_m, hand_parameters(NOVICE, constants), scored)
    grip = hand_parameters(TYPICAL, constants)
    trembles = 1e3 * hand_motion_m(position_m, force_N, device, grip, band_Hz=BAND_HZ)
    tick = (trembles[:scored] ** 2).sum(axis=1)
    # A window begins at every tick. With a few adjacent windows, the result would depend on where
    # they begin.
    sums = np.concatenate([[0.0], np.cumsum(tick)])
    tremor = float(np.sqrt(np.quantile((sums[ticks:] - sums[:-ticks]) / ticks, QUANTILE)))
    square = tick[: count * ticks].reshape(count, ticks).mean(axis=1)
    # Noise of a band has two degrees of freedom per axis, hertz and second.
    freedom = 6.0 * (BAND_HZ[1] - BAND_HZ[0]) * WINDOW_S
    drawn = np.random.default_rng(0).chisquare(freedom, (DRAWS, count)) / freedom * square
    tremors = np.sqrt(np.quantile(drawn, QUANTILE, axis=1))
    low, high = tremor * np.quantile(tremors, (0.025, 0.975)) / np.median(tremors)

    def score(size: float) -> float:
        """Return the score of a tremor [mm]."""
        worst, best = (
            sqrt(3.0) * 1e3 * hand_parameters(group, constants).tremor_m
            for group in (NOVICE, EXPERT)
        )
        return 100.0 * log(worst / max(size, LEAST_MM)) / log(worst / best)

    return Steadiness(tremor, score(tremor), score(float(high)), score(float(low)))


def hand_motion_m(
    position_m: Array,
    force_N: Array,
    device: DeviceParameters,
    grip: HandParameters,
    *,
    band_Hz: tuple[float, float],
) -> Array:
    """Compute the intended motion of a hand [m], shape (n, 3), in a frequency band.

    In the model, the hand pulls the device towards the intended position by a spring, a damper and
    a reflex. The hand's force is computed from the device's measured motion, inertia, damping,
    friction and motor force. The model is then solved for the intended position. If the parameters
    of the grip are correct, the result does not depend on device and tissue. The filters have no
    phase lag.

    Parameters
    ----------
    position_m, force_N
        Position of the device [m] and force that the device applied [N], with a row for each tick,
        shape (n, 3).
    device, grip
        Parameters of device and grip. The mass of the grip is added to the mass of the device.
    band_Hz
        Ends of the frequency band. The filter halves the amplitude at these frequencies.
    """
    frequency = _frequencies_Hz(len(position_m))
    s = 2j * np.pi * frequency
    place = _spectrum(position_m - position_m[0])
    velocity = _signal(s * place / (1.0 + (frequency / SMOOTH_HZ) ** 4), len(position_m))
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    friction_N = device.friction_N * velocity / np.hypot(speed, STICKS_M_S)
    pulls = (
        grip.stiffness_N_m * (1.0 + grip.reflex_share * np.exp(-s * grip.reflex_s))
        + grip.damping_N_s_m * s
    )
    moves = (device.mass_kg + grip.mass_kg) * s**2 + device.damping_N_s_m * s
    intended = place * (1.0 + moves / pulls) - _spectrum(force_N - friction_N) / pulls
    low, high = band_Hz
    with np.errstate(divide="ignore"):
        away = (frequency**2 - low * high) / (frequency * (high - low))
    return _signal(intended / (1.0 + away**4), len(position_m))


def _require_motion(position_m: Array, novice: HandParameters, scored: int | None) -> None:
    """Check that a device moves faster than a novice's tremor in 25 % of the scored ticks."""
    frequency = _frequencies_Hz(len(position_m))
    place = _spectrum(position_m - position_m[0])
    along = 2j * np.pi * frequency * place / (1.0 + (frequency / PATH_HZ) ** 4)
    speeds_mm_s = 1e3 * np.linalg.norm(_signal(along, len(position_m)), axis=1)[:scored]
    least_mm_s = 2e3 * pi * novice.tremor_Hz * novice.tremor_m
    if np.quantile(speeds_mm_s, QUANTILE) < least_mm_s:
        is_fast = speeds_mm_s >= least_mm_s
        # A shorter run helps only if the device is fast enough up to its last fast tick.
        before_rest = is_fast[: len(is_fast) - int(is_fast[::-1].argmax())]
        shorter = ""
        if np.mean(before_rest) >= 1.0 - QUANTILE:
            shorter = ", or end the run when the hand rests: set duration_s"
        raise InputError(
            f"the device moves at {least_mm_s:.1f} mm/s or faster for "
            f"{100.0 * np.mean(is_fast):.0f} % of the scored "
            f"{len(speeds_mm_s) * TICK_S:.2f} s. A score needs 25 %, because at lower speeds "
            "friction hides the tremor. Set a smaller coupling.motion_scale, with which at the "
            f"same speed of the tool the device moves farther{shorter}"
        )


def _frequencies_Hz(ticks: int) -> Array:
    """Return the frequencies [Hz] of the rows that `_spectrum` returns, shape (frequencies, 1)."""
    found = np.fft.rfftfreq(ticks + 2 * round(PAD_S / TICK_S), TICK_S)[:, None]
    return np.asarray(found, dtype=np.float64)


def _spectrum(values: Array) -> Spectrum:
    """Return the spectrum of values, one row per tick, after their extension at both ends."""
    pad = round(PAD_S / TICK_S)
    return np.fft.rfft(np.pad(values, ((pad, pad), (0, 0)), mode="edge"), axis=0)


def _signal(spectrum: Spectrum, ticks: int) -> Array:
    """Return the values of a spectrum, one row per tick, without the extensions at both ends."""
    pad = round(PAD_S / TICK_S)
    whole: Array = np.fft.irfft(spectrum, ticks + 2 * pad, axis=0)
    return whole[pad : pad + ticks]
