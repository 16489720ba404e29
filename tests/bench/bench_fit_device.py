"""Share of planted masses, damping, friction and motor gains of a device inside their 90 % intervals.

`python tests/bench/bench_fit_device.py FITS [noise | encoder | perfect]`: one log free, one held, 6 s each at 1 kHz.

noise
    Encoder steps of 55 um; amplifiers and delays drawn from their ranges; a ripple of the friction of 10 mN
    (correlated over 20 ms, Student's law with four degrees of freedom); a force sensor with 10 mN of white noise at
    1 kHz, a bias of 50 mN, and a clock 5 ms off (standard deviations).
encoder
    The same without ripple, and with an exact sensor.
perfect
    No encoder steps either, no lag, no delay.

Devices are simulated here, all at once, apart from the package: steps of 0.1 ms, exact but for friction, whose direction
is right to second order. The package's own, of first order in its five substeps a tick, makes the mass 0.04 % too great.
"""

import sys
from multiprocessing import Pool

import numpy as np
from scipy.interpolate import CubicSpline

from tissue.fitting.device import GAIN, device_fit
from tissue.fitting.device_windows import DeviceLog
from tissue.fitting.posterior import maximum_posterior
from tissue.materials.constants import constants
from tissue.materials.prior import Prior

SECONDS, FINE = 6.0, 10
RIPPLE_N, SENSOR_N, BIAS_N, CLOCK_S = 0.01, 0.01, 0.05, 0.005
HERTZ = np.array([[1.1, 2.3, 4.7], [1.4, 2.9, 5.3]])
NAMES = ("mass", "damping", "friction", "gain")


def swung(planted, lag_s, delay_s, encoder_m, ripple_N, rng):
    """Positions and forces, both (fits, n, 3): swung by motors with their lags, or by a hand for a lag of None."""
    fits, ticks, step = len(planted), round(1e3 * SECONDS), 1e-3 / FINE
    mass, damping, friction, gain = (planted[:, [at]] for at in range(4))
    phase = rng.uniform(0.0, 2.0 * np.pi, (fits, 2, 3))

    def wanted(time_s):
        return 1.2 * np.sin(2.0 * np.pi * HERTZ * time_s + phase).sum(axis=2)

    force = np.array([wanted(1e-3 * tick) for tick in range(ticks)])
    position = np.empty((ticks, fits, 2))
    x, v, motor, ripple = (np.zeros((fits, 2)) for _ in range(4))
    decay, brake = np.exp(-damping / mass * step), 0.5 * friction / mass * step
    keeps = np.exp(-1e-3 / 0.02)
    for at in range(ticks * FINE):
        if at % FINE == 0:
            position[at // FINE] = x
            shaken = rng.standard_t(4.0, (fits, 2)) / np.sqrt(2.0)
            ripple = keeps * ripple + np.sqrt(1.0 - keeps**2) * ripple_N * shaken
        if lag_s is None:
            mean = wanted((at + 0.5) * step)
        else:
            given = np.floor(at / FINE - delay_s / 1e-3 + 1e-9).astype(int)
            command = np.where(given[:, None] < 0, 0.0, gain * force[np.maximum(given, 0), np.arange(fits)])
            share = np.exp(-step / np.maximum(lag_s, 1e-9))[:, None]
            after = command + (motor - command) * share
            mean, motor = (0.5 * (motor + after) if lag_s.any() else command), after
        v = _braked(v, brake)
        last = (mean + ripple) / damping
        x, v = x + last * step + (v - last) * (1.0 - decay) * mass / damping, last + (v - last) * decay
        v = _braked(v, brake)
    position, force = (np.pad(each.transpose(1, 0, 2), ((0, 0), (0, 0), (0, 1))) for each in (position, force))
    return (encoder_m * np.round(position / encoder_m) if encoder_m else position), force


def _braked(v, most):
    """Velocities after friction took so much of them [m/s]."""
    speed = np.sqrt((v * v).sum(axis=1, keepdims=True))
    return v * np.maximum(1.0 - most / np.maximum(speed, 1e-30), 0.0)


def fitted(logs):
    """Intervals of the constants, shape (4, 3)."""
    found = maximum_posterior(*device_fit("touch", *logs))
    return np.array([found.interval(at) for at in range(4)])


def main(fits: int, kind: str) -> None:
    """Plant, simulate, fit and count."""
    cited, rng = constants("devices", "touch"), np.random.default_rng(3)
    priors = [Prior.of(cited[name], name) for name in ("mass_kg", "damping_N_s_m", "friction_N")] + [GAIN.prior]
    planted = np.column_stack([prior.x(rng.standard_normal(fits)) for prior in priors])
    amplifier = Prior.of(cited["amplifier_Hz"], "amplifier_Hz").x(rng.standard_normal(fits))
    lag, delay = 0.5 / np.pi / amplifier, rng.uniform(0.0, 2e-3, fits)
    noise, encoder = kind == "noise", 0.0 if kind == "perfect" else cited["encoder_step_m"].value
    if kind == "perfect":
        lag, delay = np.zeros(fits), np.zeros(fits)
    times = 1e-3 * np.arange(round(1e3 * SECONDS))
    free, commands = swung(planted, lag, delay, encoder, noise * RIPPLE_N, rng)
    tips, hands = swung(planted, None, None, encoder, noise * RIPPLE_N, rng)
    logs = []
    for at in range(fits):
        hand, later_s = hands[at], noise * CLOCK_S * rng.standard_normal()
        hand = CubicSpline(times, hand)(times - later_s)
        hand[:, :2] += noise * (SENSOR_N * rng.standard_normal((len(times), 2)) + BIAS_N * rng.standard_normal(2))
        logs.append((DeviceLog(times, free[at], commands[at]), DeviceLog(times, tips[at], np.zeros_like(hand), hand)))
    with Pool(2) as pool:
        found = []
        for each in pool.imap(fitted, logs, chunksize=5):
            found.append(each)
            if len(found) % 50 == 0 or len(found) == fits:
                report(np.array(found), planted[: len(found)])


def report(found, planted):
    """Print how often intervals hold, and how far off they are."""
    print(f"{len(found)} fits")
    low, middle, high = np.moveaxis(found, 2, 0)
    for at, name in enumerate(NAMES):
        true = planted[:, at]
        off = middle[:, at] / true - 1.0
        print(
            f"{name:9} inside {np.mean((low[:, at] < true) & (true < high[:, at])):6.1%}  bias {off.mean():+.3%}  "
            f"rms {np.sqrt(np.mean(off**2)):.3%}  half width {np.mean(0.5 * (high - low)[:, at] / true):.3%}",
            flush=True,
        )


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else "noise")
