"""Sobol indices against closed forms."""

import numpy as np
import pytest
from scipy.special import ndtr

from tissue.fitting.bands.sample import LEAST_EXPLAINED, normals, sobol_indices, surrogate_indices
from tissue.show.figures.band_pictures import _label

SEPARATE = ((0,), (1,), (2,))


def ishigami(free):
    """Ishigami and Homma (1990), a = 7, b = 0.1, of numbers uniform in (-pi, pi)."""
    u = np.pi * (2.0 * ndtr(free) - 1.0)
    return (np.sin(u[:, 0]) + 7.0 * np.sin(u[:, 1]) ** 2 + 0.1 * u[:, 2] ** 4 * np.sin(u[:, 0]))[
        :, None
    ]


FIRST = np.array([0.3139, 0.4424, 0.0])
TOTAL = np.array([0.5576, 0.4424, 0.2437])
"""Indices of Ishigami's function in closed form."""


def test_ishigami_has_the_indices_of_its_closed_form():
    found = sobol_indices(ishigami, SEPARATE, count=4096, seed=1)
    assert found[0, 0, :, 0] == pytest.approx(FIRST, abs=0.02)
    assert found[1, 0, :, 0] == pytest.approx(TOTAL, abs=0.02)
    for ends in found[:, 1:]:
        assert (ends[1] >= ends[0]).all()
        assert (ends[1] - ends[0]).max() < 0.1
    wrong = sobol_indices(lambda free: ishigami(free[:, [1, 0, 2]]), SEPARATE, count=4096, seed=1)
    assert np.abs(wrong[0, 0, :, 0] - FIRST).max() > 0.1


def test_a_group_has_the_index_of_all_its_columns_and_a_constant_figure_has_none():
    def figures(free):
        return np.column_stack([free @ [1.0, 1.0, 2.0], np.full(len(free), 5.0)])

    found = sobol_indices(figures, ((0, 1), (2,)), count=2048, seed=0)
    assert found[1, 0, :, 0] == pytest.approx([1.0 / 3.0, 2.0 / 3.0], abs=0.01)
    assert np.isnan(found[0, 0, :, 1]).all()
    assert np.isnan(found[1, 0, :, 1]).all()


def test_a_surrogate_of_few_runs_has_the_indices_of_a_polynomial_in_closed_form():
    """3 z0 + z1 z2 has variances 9 and 1, the second of both constants together alone."""
    free = normals(64, 3, seed=2)
    figures = np.column_stack([3.0 * free[:, 0] + free[:, 1] * free[:, 2], np.full(64, 2.0)])
    found, explained = surrogate_indices(free, figures, SEPARATE, seed=0)
    assert explained[0] > 0.99
    assert found[0, 0, :, 0] == pytest.approx([0.9, 0.0, 0.0], abs=0.01)
    assert found[1, 0, :, 0] == pytest.approx([0.9, 0.1, 0.1], abs=0.01)
    assert np.isnan(found[1, 0, :, 1]).all()


def test_a_surrogate_that_explains_too_little_gives_no_indices():
    """A surrogate that explains too little gives no indices.

    The cases are noise, and few runs over many constants, where a fit with as many terms as runs
    passes through every point.
    """
    noise = np.random.default_rng(1).standard_normal((16, 1))
    columns = tuple((at,) for at in range(40))
    found, explained = surrogate_indices(normals(16, 40, seed=0), noise, columns, seed=0)
    assert explained[0] < LEAST_EXPLAINED
    assert np.isnan(found).all()


def test_labels_name_the_constant():
    assert _label("cutting.bone.radial_chip_N_mm2") == "bone radial chip"
    assert _label("density.bone + tooth.bur.heat_share") == "bone density\nbur heat share"
