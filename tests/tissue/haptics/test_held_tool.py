"""A tool on a device without its scene: balances in closed form, and what leads or pushes it."""

import numpy as np
import pytest

from tissue.haptics.hand.pushing import CompensatedPath, Thrust
from tissue.haptics.proxy.cutting_tool import CuttingTool
from tissue.haptics.proxy.held_tool import PressingTool
from tissue.models.tissue_model import Response

STEP_S = 1e-3
DOWN = np.array([0.0, 0.0, -1.0])
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
RESTING = np.zeros(6)
"""Velocity and spin of a device at rest."""


@pytest.mark.parametrize("tissue_N_m", [50.0, 400.0, 4e3, 4e4])
def test_a_pressing_tool_finds_the_balance_of_a_spring_it_does_not_know(tissue_N_m):
    """A pressing tool finds the balance of an unknown spring.

    With the device at rest in an elastic half-space, x = k_c x_d / (k_c + k_t), also if the tissue
    is a hundred times stiffer than the coupling.
    """
    tool, response = PressingTool(400.0, np.zeros(3)), Response.empty(1)
    for _ in range(200):
        tip = tool.follow(1e-3 * DOWN, UPRIGHT, RESTING, response, STEP_S)
        response.wrench[2] = max(-tissue_N_m * tip[2], 0.0)
    np.testing.assert_allclose(tip[2], -1e-3 * 400.0 / (400.0 + tissue_N_m), rtol=1e-2)


def test_a_known_stiffness_gives_the_balance_in_one_step():
    """A known stiffness gives the balance in one step.

    F = F0 - K (x - x0) with a K that differs by direction: k (x_d - x) + F(x) = 0, solved by NumPy.
    """
    start, device, spring = np.array([1e-3, 0.0, -1e-3]), np.array([1.5e-3, 2e-4, -2e-3]), 400.0
    stiffness, force = np.diag([200.0, 900.0, 3000.0]) + 40.0, np.array([0.05, -0.02, 0.8])
    tool, response = PressingTool(spring, start), Response.empty(1)
    response.wrench[:3], response.stiffness_N_m = force, stiffness
    tip = tool.follow(device, UPRIGHT, RESTING, response, STEP_S)
    wanted = np.linalg.solve(
        spring * np.eye(3) + stiffness, spring * device + force + stiffness @ start
    )
    np.testing.assert_allclose(tip, wanted, rtol=1e-12)


def test_a_balance_in_which_the_tissue_would_pull_is_none():
    """A balance in which the tissue would pull is rejected.

    The force of 0.1 N vanishes 0.25 mm out; a device 1 mm out leaves the tissue and takes its tool
    along.
    """
    tool, response = PressingTool(400.0, np.zeros(3)), Response.empty(1)
    response.wrench[2], response.stiffness_N_m = 0.1, 400.0 * np.eye(3)
    np.testing.assert_array_equal(
        tool.follow(-1e-3 * DOWN, UPRIGHT, RESTING, response, STEP_S), -1e-3 * DOWN
    )
    assert not tool.has_entered(response)
    response.wrench[2] = 0.0
    tool.follow(-1e-3 * DOWN, UPRIGHT, RESTING, response, STEP_S)
    response.wrench[2] = 0.1
    assert tool.has_entered(response)


def test_a_led_hand_goes_farther_until_the_tool_is_there():
    tool = PressingTool(1.0, np.zeros(3))
    lead = CompensatedPath(lambda time_s: 1e-3 * DOWN, tool, lead_s=0.2, furthest_m=5e-3)
    assert lead(0.0)[2] == -1e-3
    goals = [lead(1.0 + n)[2] for n in range(40)]
    assert (np.diff(goals) <= 0.0).all() and goals[-1] == pytest.approx(-6e-3)
    tool.tip_m[2] = -1e-3
    assert lead(50.0)[2] == goals[-1]


def test_a_thrust_pushes_until_the_path_is_done():
    tool = CuttingTool(1.0, np.zeros(3))
    thrust = Thrust(np.zeros(3), 2e-3 * DOWN, tool, 1.5, 4e-3)
    np.testing.assert_allclose(thrust.push(1.0), 1.5 * DOWN)
    np.testing.assert_allclose(thrust.path(1.0), 4e-3 * DOWN)
    tool.tip_m[:] = 2e-3 * DOWN
    assert not thrust.push(1.0).any()
    np.testing.assert_allclose(thrust.path(1.0), 2e-3 * DOWN)
