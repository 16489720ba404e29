"""Channels of reversed sign are named, whichever they are, and no others."""

from dataclasses import replace

import numpy as np
import pytest
from planted_logs import planted, slot

from meshes.base.errors import InputError
from tissue.fitting.posterior import require_signs, reversed_channels

CHANNELS = ("force_x_N", "force_y_N", "force_z_N")


def coarse_slot():
    """A slot at a tenth of the samples, to save time."""
    whole = slot()
    return replace(whole, times_s=whole.times_s[::10], basis=whole.basis[::10])


@pytest.fixture(scope="module")
def log():
    return planted(coarse_slot(), np.random.default_rng(3), scale=0.2)[0]


@pytest.mark.parametrize("wrong", [(2,), (0, 1, 2)])
def test_channels_of_reversed_sign_are_named(log, wrong):
    signs = np.ones(3)
    signs[list(wrong)] = -1.0
    found = reversed_channels(coarse_slot(), replace(log, values=log.values * signs))
    assert found == tuple(CHANNELS[at] for at in wrong)


def test_a_channel_of_noise_has_no_sign(log):
    values = log.values.copy()
    values[:, 1] = np.random.default_rng(4).standard_normal(len(values))
    forward = coarse_slot()
    forward.basis[:, 1] = 0.0
    assert reversed_channels(forward, replace(log, values=values * [1.0, -1.0, 1.0])) == ()


def test_the_remedy_names_the_channel(log):
    with pytest.raises(InputError, match=r"got force_z_N with.*--column force_z_N=-COLUMN"):
        require_signs(coarse_slot(), replace(log, values=log.values * [1.0, 1.0, -1.0]))
