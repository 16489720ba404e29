"""Perception against closed forms.

They are Weber, Stevens' predictive and the inverse map.
"""

import numpy as np
import pytest

from tissue.perception.laws import (
    ForceMap,
    Intensity,
    LogTable,
    Weber,
    correct_of_d_prime,
    intensity_of,
    two_interval,
    weber_of,
)
from tissue.perception.observer import Observer, population, population_observer, reference_observer
from tissue.perception.perceived import Sense

KNEE_N = 2.31
"""Strongest force that a Touch plays uncompressed [N]: 0.7 of 3.3."""


def person(**changed):
    given = {
        "alpha": 1.0,
        "beta": 1.7,
        "kappa": 0.07,
        "offset_N": 0.2,
        "lapse": 0.02,
        "sigma": 0.2,
    } | changed
    return Observer.known("someone", **given)


def people(count, seed):
    """Observers of many kinds, known well or badly."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield person(
            alpha=np.exp(rng.normal(0.0, 0.5)),
            beta=rng.uniform(1.0, 2.2),
            kappa=rng.uniform(0.04, 0.2),
            offset_N=rng.uniform(0.1, 0.3),
            spread={"alpha": rng.uniform(0, 0.4), "beta": rng.uniform(0, 0.3)},
        )


def test_weber_is_7_percent_of_strong_forces_and_more_of_weak_ones():
    law = weber_of(population_observer())
    assert law.threshold(10.0) == pytest.approx(0.07 * 10.2)
    shares = law.threshold([0.1, 0.2, 0.5, 5.0]) / [0.1, 0.2, 0.5, 5.0]
    # within the cited 10-28 %
    assert shares[0] == pytest.approx(0.21) and shares[1] == pytest.approx(0.14)
    assert 0.07 < shares[-1] < 0.075


def test_a_quantile_of_the_threshold_leaves_nine_in_ten_above_it():
    observer = person(spread={"kappa": 0.3})
    drawn = observer.draw(200_000, np.random.default_rng(1))["kappa"]
    # 5 standard errors
    assert (drawn > weber_of(observer, quantile=0.1).kappa).mean() == pytest.approx(0.9, abs=0.004)
    assert weber_of(observer).kappa == pytest.approx(0.07)


def test_moments_of_intensity_are_those_of_quadrature():
    """Moments of intensity agree with quadrature.

    Gauss-Hermite over both coordinates, 60 nodes a side, is compared with the closed forms, with a
    correlation.
    """
    law = Intensity(log_alpha=-0.1, beta=1.6, variances=(0.09, 0.02, 0.04), scatter=0.05)
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    weights = weights / weights.sum()
    root = np.linalg.cholesky([[0.09, 0.02], [0.02, 0.04]])
    for force in (0.05, 0.4, 1.0, 3.0, 12.0):
        u, v = np.meshgrid(nodes, nodes, indexing="ij")
        log_alpha, beta = -0.1 + root[0, 0] * u, 1.6 + root[1, 0] * u + root[1, 1] * v
        both = np.outer(weights, weights)
        evoked = np.exp(log_alpha + beta * np.log(force))
        mean, square = (both * evoked).sum(), (both * evoked**2).sum() * 1.05
        assert law.expected(force) == pytest.approx(mean, rel=1e-10)
        assert law.spread(force) == pytest.approx(np.sqrt(square - mean**2), rel=1e-9)


@pytest.mark.parametrize("uncertain", [0.0, 0.25, 0.5])
def test_the_scatter_of_a_rating_is_the_mean_of_sigma_squared(uncertain):
    """The scatter of a rating is the mean of sigma squared.

    Gauss-Hermite over ln sigma, 60 nodes, and over the noise of one rating, is compared with the
    law's scatter and spread.
    """
    observer = person(sigma=0.3, spread={"sigma": uncertain})
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    weights = weights / weights.sum()
    mean_square = weights @ (0.3 * np.exp(uncertain * nodes)) ** 2
    law = intensity_of(observer)
    assert law.scatter == pytest.approx(mean_square, rel=1e-10)
    # Everything else is known: a rating is the intensity of 2 N times 1 + sigma times a standard
    # normal number.
    assert law.spread(2.0) == pytest.approx(law.expected(2.0) * np.sqrt(mean_square), rel=1e-10)


def test_intensity_is_inverted_for_every_observer():
    forces = np.geomspace(0.05, 50.0, 400)
    for observer in people(100, 2):
        law = intensity_of(observer)
        assert np.allclose(law.force_N(law.expected(forces)), forces, rtol=1e-11, atol=0.0)
    assert law.expected(0.0) == law.spread(0.0) == law.force_N(0.0) == 0.0


def test_people_have_the_laws_that_are_stated():
    law, drawn = population(), population().draw(400_000, np.random.default_rng(3))
    # five standard errors, here and below
    assert drawn["alpha"].mean() == pytest.approx(1.0, abs=0.003)
    assert drawn["beta"].mean() == pytest.approx(1.7, abs=0.002) and drawn[
        "beta"
    ].std() == pytest.approx(0.2, abs=0.002)
    assert (drawn["sigma"] ** 2).mean() == pytest.approx(law.sigma**2, rel=0.005)
    # of an inverse-gamma variance this is gamma: mean / std = sqrt(shape)
    inverse = 1.0 / drawn["sigma"] ** 2
    assert (inverse.mean() / inverse.std()) ** 2 == pytest.approx(law.sigma_shape, rel=0.02)
    coordinates = Observer.from_draws("drawn", drawn, trials=0)
    assert coordinates.mean == pytest.approx(population_observer().mean, abs=0.005)
    assert coordinates.covariance == pytest.approx(population_observer().covariance, abs=0.005)
    assert intensity_of(population_observer()).expected(1.0) == pytest.approx(1.0)


def test_e5_the_reference_feels_what_was_wanted_to_1e_6():
    """The observer's expected intensity equals the reference's to 1e-6.

    It is the intensity of the command for the observer and of the force for the reference; by
    table, every choice.
    """
    reference = intensity_of(reference_observer())
    forces = np.geomspace(0.3, KNEE_N, 500)
    observers = [reference_observer(), population_observer(), *people(60, 4)]
    for observer in observers:
        law = ForceMap(reference, intensity_of(observer), lowest_N=0.3, knee_N=KNEE_N)
        table = np.array([law.table.at(force) for force in forces])
        felt = intensity_of(observer).expected(table)
        assert np.allclose(felt, reference.expected(law.gain * forces), rtol=1e-6, atol=0.0)
        assert np.allclose(table, law.command_N(forces), rtol=1e-6, atol=0.0)
        assert np.allclose([law.intensity.at(force) for force in table], felt, rtol=1e-6, atol=0.0)
    identity = ForceMap(reference, reference, lowest_N=0.2, knee_N=KNEE_N)
    assert np.allclose([identity.table.at(force) for force in forces], forces, rtol=1e-12, atol=0.0)
    assert identity.gain == 1.0


def test_ratios_of_intensity_survive_up_to_the_knee_and_the_device_is_never_asked_for_more():
    """Ratios of intensity survive up to the knee, within the device's limit.

    With gain 1 or below, E[S(c(F1))] / E[S(c(F2))] = (F1 / F2)^1.7 for every observer and pair.
    """
    reference, forces = intensity_of(reference_observer()), np.geomspace(0.3, KNEE_N, 80)
    wanted = np.divide.outer(forces, forces) ** 1.7
    gains = []
    for observer in people(60, 5):
        law = ForceMap(reference, intensity_of(observer), lowest_N=0.3, knee_N=KNEE_N)
        commands = law.command_N(forces)
        felt = intensity_of(observer).expected(commands)
        assert np.allclose(np.divide.outer(felt, felt), wanted, rtol=1e-9, atol=0.0)
        assert commands.max() <= KNEE_N * (1 + 1e-12)
        gains.append(law.gain)
    assert min(gains) < 0.9 and max(gains) == 1.0


def test_the_map_rises_from_nothing_and_its_slope_is_reported():
    reference = intensity_of(reference_observer())
    for observer in people(40, 6):
        law = ForceMap(reference, intensity_of(observer), lowest_N=0.2, knee_N=KNEE_N)
        forces = np.linspace(0.0, KNEE_N, 3001)
        commands = np.array([law.table.at(force) for force in forces])
        slopes = np.diff(commands) / np.diff(forces)
        assert commands[0] == 0.0 and slopes.min() > 0.0
        assert slopes.max() == pytest.approx(law.steepest, rel=5e-3)
        assert np.allclose(law.command_N(forces), commands, rtol=1e-6, atol=0.0)


def test_a_table_is_exact_for_a_power_law():
    forces = np.geomspace(0.1, 10.0, 5)
    table = LogTable(forces, 3.0 * forces**0.6)
    for force in (0.1, 0.1234, 1.0, 7.7, 9.999):
        assert table.at(force) == pytest.approx(3.0 * force**0.6, rel=1e-14)
    assert table.at(0.05) == pytest.approx(0.5 * table.at(0.1)) and table.at(0.0) == 0.0
    assert table.at(20.0) == pytest.approx(2.0 * table.at(10.0))


def test_a_sense_scatters_by_its_threshold_():
    """A sense scatters by its threshold.

    Two constant forces a threshold apart are discriminated at d' = 0.954: 75 % in two intervals.
    """
    law = Weber(kappa=0.07, offset=0.2)
    estimates = []
    for force, seed in ((2.0, 9), (2.0 + float(law.threshold(2.0)), 10)):
        sense = Sense(law, integration_s=0.1, tick_s=1e-3, rng=np.random.default_rng(seed))
        estimates_N = np.array([sense.step(force) for _ in range(400_000)])[1000:]
        assert estimates_N.mean() == pytest.approx(force, abs=0.02)
        estimates.append(estimates_N[::500])  # five time constants apart: independent
    weak, strong = estimates
    # 800 looks: 2.5 %
    assert weak.std() == pytest.approx(float(law.threshold(2.0)) / 0.9538725524, rel=0.12)
    right = np.mean(strong[:, None] > weak[None, :])
    assert right == pytest.approx(0.75, abs=0.04)


def test_the_threshold_is_that_of_two_intervals():
    assert two_interval(
        2.0, weber_of(population_observer()).threshold(2.0), 0.07, 0.2
    ) == pytest.approx(0.75)
    assert correct_of_d_prime(0.9538725524) == pytest.approx(0.75)
