"""A tick of a ball above a plane against the closed form, as the kernel writes it."""

import numpy as np
import pytest
from field_distance import half_space

from kernels.proxy import (
    CENTRE,
    CONVERGED,
    FORCE,
    MOMENT,
    POSITION,
    PRESSING,
    ROTATION,
    SOLVES,
    STEPS,
    TRAVEL,
)
from tissue.haptics.proxy.proxy import ContactField, Proxy, ToolShell

EXACT_M = 1e-11
"""Tolerance [m] of the proxy next to solids, times the ten steps that a tick takes."""
RADIUS_M, START_M = 1e-3, 3e-3
NORMAL = np.array([0.2, -0.3, 1.0]) / np.linalg.norm([0.2, -0.3, 1.0])


def tick(device_m, *, friction=0.0, lever_m=None):
    """Return state and report after one tick from above the plane.

    The ball's centre lies off the tool's origin.
    """
    arm = np.array([1e-3, 2e-3, -1e-3])
    field = ContactField(half_space(np.zeros(3), NORMAL))
    shell = ToolShell.ball(RADIUS_M, centre_m=tuple(arm))
    proxy = Proxy(shell, field, friction=friction, lever_m=lever_m)
    proxy.place(START_M * NORMAL - arm)
    proxy.advance(device_m - arm)
    return proxy._state.host, proxy._report.host, arm


@pytest.mark.parametrize("lever_m", [None, 0.02])
def test_a_free_device_is_followed(lever_m):
    device = 2e-3 * NORMAL + np.array([1e-3, 0.0, 0.0])
    state, report, arm = tick(device, lever_m=lever_m)
    assert state[POSITION : POSITION + 3] == pytest.approx(device - arm, abs=EXACT_M)
    assert state[ROTATION : ROTATION + 4] == pytest.approx(
        np.array([0.0, 0.0, 0.0, 1.0]), abs=EXACT_M
    )
    assert state[TRAVEL] == pytest.approx(np.linalg.norm(device - START_M * NORMAL), rel=1e-6)
    assert report[[CONVERGED, PRESSING]].tolist() == [1.0, 0.0] and report[STEPS] >= 1.0
    assert not report[FORCE : FORCE + 3].any() and not report[MOMENT : MOMENT + 3].any()


@pytest.mark.parametrize("friction", [0.0, 0.2, 5.0])
def test_a_ball_rests_on_the_plane_below_its_device(friction):
    """A ball rests on the plane below its device.

    The device moves d = 0.5 mm deep and 2 d along, from 4 d above contact; the ball reaches the
    plane after 1.6 d along. There friction holds the ball, or lets it slide until it pulls back by
    the coefficient times d.
    """
    depth, along = 5e-4, np.cross(NORMAL, [1.0, 0.0, 0.0])
    along /= np.linalg.norm(along)
    device = (RADIUS_M - depth) * NORMAL + 2.0 * depth * along
    state, report, arm = tick(device, friction=friction)
    centre = RADIUS_M * NORMAL + max(1.6, 2.0 - friction) * depth * along
    force = centre - device
    assert report[[CONVERGED, PRESSING]].tolist() == [1.0, 1.0] and report[SOLVES] >= 1.0
    assert state[POSITION : POSITION + 3] == pytest.approx(centre - arm, abs=EXACT_M)
    assert report[FORCE : FORCE + 3] == pytest.approx(force, abs=EXACT_M)
    at = arm - RADIUS_M * NORMAL
    assert report[CENTRE : CENTRE + 3] == pytest.approx(at, abs=EXACT_M)
    assert report[MOMENT : MOMENT + 3] == pytest.approx(np.cross(at, force), abs=EXACT_M)
