"""Silicone cylinders pressed to 60 % strain: laws fitted to batch A predict batch B.

Each hyperelastic law is tested. Cylinders and platens are as in `test_silicone`. The platens are
assumed frictionless and the silicone incompressible, so the force is the closed form of uniaxial
compression.
"""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import least_squares
from silicone_traces import MIXES, traces

from tissue.materials.hyperelasticity import Hyperelastic

STRAIN = 0.6
BULK_PA = 1e6
"""Any positive value: the difference of two stresses at constant volume has no pressure in it."""
EVERY = 20
"""Rows of a trace between those that are compared: neighbours hold the same information."""
LAWS: dict[str, tuple[Callable[..., Hyperelastic], tuple[float, ...]]] = {
    "neo-hookean": (Hyperelastic.neo_hookean, (3.0,)),
    "mooney-rivlin": (Hyperelastic.mooney_rivlin, (1.0, 1.0)),
    "yeoh": (Hyperelastic.yeoh, (1.0, 0.1, 0.1)),
    "ogden": (lambda mu, alpha, bulk_Pa: Hyperelastic(bulk_Pa, ((mu, 1e-3 * alpha),)), (3.0, 4.0)),
}
"""Constructor and the start of its constants [kPa]; Ogden's exponent is scaled as they are."""


def pressure(law: Hyperelastic, strain: np.ndarray) -> np.ndarray:
    """Force over undeformed area [Pa] of an incompressible column without friction."""
    along = 1.0 - strain
    across = along**-0.5
    stress = law.stress(np.stack([across, across, along], axis=-1)[:, None, :] * np.eye(3))
    return np.asarray(stress[:, 0, 0] * across / along - stress[:, 2, 2])


def fitted(name: str, known: list[tuple[np.ndarray, np.ndarray]]) -> Hyperelastic:
    make, start = LAWS[name]
    strain, measured = (np.concatenate(part) for part in zip(*known, strict=True))

    def off(kPa: np.ndarray) -> np.ndarray:
        return 1e-3 * (pressure(make(*(1e3 * kPa), bulk_Pa=BULK_PA), strain) - measured)

    return make(*(1e3 * least_squares(off, start, bounds=(1e-9, np.inf)).x), bulk_Pa=BULK_PA)


def shares_off(law: Hyperelastic, tests: list[tuple[np.ndarray, np.ndarray]]) -> list[float]:
    return [float(np.linalg.norm(pressure(law, s) - p) / np.linalg.norm(p)) for s, p in tests]


@pytest.mark.parametrize("name", LAWS)
def test_a_fit_returns_the_law_that_was_planted(name):
    make, start = LAWS[name]
    planted = make(*(1.7e3 * np.array(start)), bulk_Pa=BULK_PA)
    strain = np.linspace(0.0, STRAIN, 50)
    law = fitted(name, [(strain, pressure(planted, strain))])
    assert shares_off(law, [(strain, pressure(planted, strain))])[0] < 1e-6


def test_batch_predicts_batch_to_60_percent(anatomy, capsys):
    """One batch predicts the other to 60 percent.

    Laws with two constants or more predict batch B within 10 % (L2, mean of its five tests);
    neo-Hookean does not. Single cylinders of the softest mix are up to 11 % off.
    """
    lines, errors = [], {name: [] for name in LAWS}
    for mix in MIXES:
        known, unknown = (
            [
                (s[s <= STRAIN][::EVERY], p[s <= STRAIN][::EVERY])
                for s, p in traces(anatomy, mix, batch)
            ]
            for batch in "AB"
        )
        for name in LAWS:
            shares = shares_off(fitted(name, known), unknown)
            errors[name].append(float(np.mean(shares)))
            lines.append(
                f"{mix:10} {name:14} batch B off by {np.mean(shares):6.1%}, at most "
                f"{max(shares):6.1%}"
            )
    with capsys.disabled():
        print("\n" + "\n".join(lines))
    assert max(errors["mooney-rivlin"] + errors["yeoh"] + errors["ogden"]) < 0.10
    assert min(errors["neo-hookean"]) > 0.10
