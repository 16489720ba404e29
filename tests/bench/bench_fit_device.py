"""Share of planted masses, damping, friction and motor gains of a simulated device inside their 90 % intervals.

`python tests/bench/bench_fit_device.py FITS`: encoder steps of 55 um, amplifiers of 300 Hz, a delay of 0.5 ms; a free log and a held one.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tissue" / "fitting"))
from test_device_fit import swung

from tissue.fitting.device import GAIN, DeviceLog, device_fit
from tissue.fitting.posterior import maximum_posterior
from tissue.materials.constants import constants
from tissue.materials.prior import Prior


def main(fits: int) -> None:
    """Plant, fit and count."""
    cited = constants("devices", "touch")
    priors = [Prior.of(cited[name], name) for name in ("mass_kg", "damping_N_s_m", "friction_N")] + [GAIN.prior]
    rng = np.random.default_rng(3)
    inside, off, wide = [], [], []
    for seed in range(fits):
        planted = np.array([float(prior.x(z)) for prior, z in zip(priors, rng.standard_normal(4), strict=True)])
        log, other = (swung(tuple(planted[:3]), seed=2 * seed + number) for number in range(2))
        free = DeviceLog(log.times_s, log.position_m, log.force_N / planted[3])
        held = DeviceLog(other.times_s, other.position_m, np.zeros_like(other.force_N), other.force_N)
        # The sum of sines of each seed moves the device by centimetres: friction is overcome in all of them.
        found = maximum_posterior(*device_fit("touch", (free, held)))
        interval = np.array([found.interval(at) for at in range(4)])
        inside.append((interval[:, 0] < planted) & (planted < interval[:, 2]))
        off.append(interval[:, 1] / planted - 1.0)
        wide.append(0.5 * (interval[:, 2] - interval[:, 0]) / planted)
    for at, name in enumerate(("mass", "damping", "friction", "gain")):
        column = np.array(off)[:, at]
        print(
            f"{name:9} inside {np.mean(np.array(inside)[:, at]):6.1%}  bias {column.mean():+.2%}  "
            f"rms {np.sqrt(np.mean(column**2)):.2%}  stated half width {np.mean(np.array(wide)[:, at]):.2%}"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]))
