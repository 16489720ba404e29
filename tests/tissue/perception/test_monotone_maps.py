"""Limits of a monotone map of the force: differences between its end points are conserved."""

import numpy as np
import pytest
from held_back import held_back

from tissue.evaluation.calibration.observers import Stimulus, draw_observers, sensitivity
from tissue.objects.calibration import alike
from tissue.perception.laws import D_PRIME_75, Weber

LIMIT_N = 3.3
KAPPA, OFFSET_N = 0.05, 0.2
MAPS = {
    "unchanged": lambda force: force,
    "exponent 1.2": lambda force: LIMIT_N * (force / LIMIT_N) ** 1.2,
    "exponent 0.8": lambda force: LIMIT_N * (force / LIMIT_N) ** 0.8,
    # steepest at half of the range
    "steep in the middle": lambda force: (
        0.5 * LIMIT_N * (1.0 + np.tanh(3.0 * (force / LIMIT_N - 0.5)) / np.tanh(1.5))
    ),
}
"""Rising maps of 0 to 3.3 N onto 0 to 3.3 N."""
BANDS_N = ((0.0, 0.8), (0.8, 1.6), (1.6, LIMIT_N))


def d_prime(from_N, to_N, made, scatter_N=0.0):
    """Return the sum of d' of small steps of the force, for an observer after a map.

    The scatter passes through the map with its slope over the step.
    """
    observer = alike(1, kappa=KAPPA, offset_N=OFFSET_N)
    forces_N = np.linspace(from_N, to_N, 1500)
    levels_N = made(forces_N)
    slopes = np.diff(levels_N) / np.diff(forces_N)
    return sum(
        sensitivity(
            observer, Stimulus(low, slope * scatter_N), Stimulus(high, slope * scatter_N)
        ).item()
        for low, high, slope in zip(levels_N[:-1], levels_N[1:], slopes, strict=True)
    )


@pytest.mark.parametrize("name", MAPS)
def test_the_number_of_noticeable_differences_follows_from_the_end_points(name):
    """The sum over the range is ln((F2 + F0) / (F1 + F0)) / kappa for every map, by hand."""
    count = d_prime(0.0, LIMIT_N, MAPS[name]) / D_PRIME_75
    # 1,500 steps in place of the integral: up to 0.34 %
    assert count == pytest.approx(np.log(1.0 + LIMIT_N / OFFSET_N) / KAPPA, rel=0.005)


@pytest.mark.parametrize("name", list(MAPS)[1:])
def test_a_gain_in_one_band_is_paid_in_another(name):
    changes = [d_prime(*band, MAPS[name]) - d_prime(*band, MAPS["unchanged"]) for band in BANDS_N]
    assert max(changes) > 1.0 and min(changes) < -1.0
    # the steps in place of the integral: up to 0.02
    assert sum(changes) == pytest.approx(0.0, abs=0.05)


def test_a_deadband_counts_the_same_number_of_changes():
    """Changes of one threshold are counted on a slow ramp, by the deadband of the haptic loop."""
    law = Weber(kappa=KAPPA, offset=OFFSET_N)
    ramp_N = np.linspace(0.0, LIMIT_N, 20_000)
    counts = []
    for made in MAPS.values():
        vectors = np.column_stack([0.0 * ramp_N, 0.0 * ramp_N, made(ramp_N)])
        counts.append(held_back(vectors, law)[1].sum())
    expected = np.log(1.0 + LIMIT_N / OFFSET_N) / np.log(1.0 + KAPPA)
    assert np.ptp(counts) <= 1
    # a count is a whole number
    assert abs(counts[0] - expected) < 1.0


def test_a_map_that_widens_the_range_adds_differences():
    """Twice the force gives ln((2 F + F0) / F0) / kappa differences."""
    count = d_prime(0.0, LIMIT_N, lambda force: 2.0 * force) / D_PRIME_75
    # the steps in place of the integral: 0.30 %
    assert count == pytest.approx(np.log(1.0 + 2.0 * LIMIT_N / OFFSET_N) / KAPPA, rel=0.005)


def test_scatter_of_the_force_passes_through_a_map():
    """Scatter far above the threshold leaves no gain; without scatter the gain is 20 %."""
    band = (1.9, 2.1)
    steep = MAPS["exponent 1.2"]
    alone = d_prime(*band, steep) / d_prime(*band, MAPS["unchanged"])
    scattered = d_prime(*band, steep, 2.0) / d_prime(*band, MAPS["unchanged"], 2.0)
    assert alone == pytest.approx(1.19, abs=0.01)
    assert scattered == pytest.approx(1.0, abs=0.003)


@pytest.mark.parametrize(
    ("softer", "stiffer", "kept", "lifted"),
    [
        # palpation, bone, caries and the capsule of a liver: forces of the study in docs/paper.md
        (Stimulus(0.385, 0.007), Stimulus(0.436, 0.010), 3.0, 12.9),
        (Stimulus(0.541, 0.024), Stimulus(0.553, 0.025), 6.4, 13.1),
        (Stimulus(0.329, 0.009), Stimulus(0.559, 0.010), 4.4, 15.2),
        (Stimulus(2.005, 0.029), Stimulus(2.454, 0.032), 20.3, 22.7),
    ],
)
def test_an_exponent_of_1_2_gains_where_forces_are_strong(softer, stiffer, kept, lifted):
    """Changes of d' in percent in open loop, with 3.3 N kept and with 1 N kept."""
    people = draw_observers("intermediate", 200, np.random.default_rng(0))
    plain = sensitivity(people, softer, stiffer).mean()

    def change(kept_N):
        mapped = [
            Stimulus(
                kept_N * (each.level_N / kept_N) ** 1.2,
                1.2 * (each.level_N / kept_N) ** 0.2 * each.scatter_N,
            )
            for each in (softer, stiffer)
        ]
        return 100.0 * (sensitivity(people, *mapped).mean() / plain - 1.0)

    # docs/paper.md gives whole percents
    assert change(LIMIT_N) == pytest.approx(kept, abs=0.5)
    assert change(1.0) == pytest.approx(lifted, abs=0.5)
