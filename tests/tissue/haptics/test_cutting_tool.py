"""Balance of a tool that cuts, along its feed and across it.

The tests cover closed forms, energy, and stability over decades.
"""

from itertools import product

import numpy as np
import pytest
from ball_cut import STEP_S, UPRIGHT, BallOnBlock, lead

from tissue.haptics.proxy.cutting_tool import CuttingTool
from tissue.models.tissue_model import Response

DOWN = np.array([0.0, 0.0, -1.0])


def ramp(velocity_m_s, seconds=1.0):
    """Return a device that moves on at a velocity [m/s]."""
    return STEP_S * np.arange(round(seconds / STEP_S))[:, None] * np.asarray(velocity_m_s)


def fixed(edge_N, drag_N_s_m):
    """A law whose force has the same direction whatever the heading."""

    def law(tip_m, heading, speed_m_s):
        response = Response.empty(1)
        response.edge[:3], response.resistance[:3] = -np.asarray(edge_N), -np.asarray(drag_N_s_m)
        response.wrench[:3] = (
            response.edge[:3] if speed_m_s > 0.0 else 0.0
        ) + speed_m_s * response.resistance[:3]
        return response

    return law


def against(edge_N, drag_N_s_m):
    """A law that resists along the heading, alike in all directions."""

    def law(tip_m, heading, speed_m_s):
        return fixed(edge_N * heading, drag_N_s_m * heading)(tip_m, heading, speed_m_s)

    return law


@pytest.mark.parametrize("drag_N_s_m", [0.0, 3e3, 1e5])
def test_an_oblique_pull_turns_the_tool_into_its_direction(drag_N_s_m):
    """An oblique pull turns the tool into its direction.

    The resistance is equal in all directions, E + C v along the motion: the device turns by 60
    degrees, and so does the tool.
    """
    there = ramp((5e-3, 0.0, 0.0), 6.0)
    back = there[-1] + ramp((2.5e-3, 4.33e-3, 0.0), 8.0)
    tool = CuttingTool(max(1e4, drag_N_s_m), np.zeros(3))
    _, pull, cut = lead(tool, against(6.0, drag_N_s_m), np.concatenate([there, back]))
    np.testing.assert_allclose(
        pull[5900], [6.0 + 5e-3 * drag_N_s_m, 0.0, 0.0], rtol=1e-2, atol=0.05
    )
    np.testing.assert_allclose(
        pull[-1], (6.0 + 5e-3 * drag_N_s_m) * np.array([0.5, 0.866, 0.0]), rtol=1e-2, atol=0.1
    )
    np.testing.assert_allclose(pull[-1], cut[-1], rtol=1e-2, atol=0.1)


@pytest.mark.parametrize("stiffness_N_m", [1e2, 1e4, 1e6])
@pytest.mark.parametrize("step_s", [1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("drag_N_s_m", [0.0, 1.0, 1e3, 1e5, 1e7])
@pytest.mark.parametrize("edge_N", [0.0, 0.01, 10.0, 1e3])
def test_it_is_stable_over_decades_of_spring_edge_resistance_and_step(
    stiffness_N_m, step_s, drag_N_s_m, edge_N
):
    """The balance is stable over decades of spring, edge, resistance and step.

    The device stops: every step shortens the spring, and the tool comes to rest within the edge
    force.
    """
    rng = np.random.default_rng(0)
    tool, device = CuttingTool(stiffness_N_m, np.zeros(3)), np.array([2e-3, -1e-3, 1.5e-3])
    law = fixed(
        edge_N * (DOWN + rng.normal(size=3)), drag_N_s_m * (DOWN + 0.5 * rng.normal(size=3))
    )
    tip, pull, _ = lead(tool, law, np.tile(device, (300, 1)), step_s=step_s)
    lengths = np.linalg.norm(device - tip, axis=1)
    assert (np.diff(lengths) <= 1e-15).all()
    assert np.isfinite(pull).all()


def test_the_spring_never_takes_energy_from_a_tool_that_cuts():
    """The spring never takes energy from a tool that cuts.

    Over a closed motion of the device, for any push of the cutter's spin, the work of the device is
    >= 0 at its end. k (x_device - x') . (x' - x) >= 0 in every tick, so that the spring's energy
    falls by k |x' - x|^2 / 2 or more.
    """
    turn = np.linspace(0.0, 4.0 * np.pi, 3000)
    round_and_back = 1e-3 * np.column_stack(
        [np.sin(turn), 1.0 - np.cos(turn), -0.5 * np.sin(0.5 * turn) ** 2]
    )
    laws = BallOnBlock().force, BallOnBlock(spin=0.0).force, against(5.0, 2e3)
    for law, damping in product(laws, (0.0, 100.0)):
        tip, pull, _ = lead(
            CuttingTool(1e4, np.zeros(3), damping_N_s_m=damping), law, round_and_back
        )
        given = (pull[1:] * np.diff(tip, axis=0)).sum(axis=1)
        assert (given >= -1e-12).all()
        device = (0.5 * (pull[1:] + pull[:-1]) * np.diff(round_and_back, axis=0)).sum()
        held = 0.5 * (pull[[0, -1]] ** 2).sum(axis=1) / 1e4
        assert device >= held[1] - held[0] > -1e-12


def test_a_spinning_ball_is_held_across_its_path_without_chatter():
    """A spinning ball is held across its path without chatter.

    Tangential forces push it aside by more than its feed force, and encoder steps of 55 um do not
    shake it.
    """
    law, tool, step = BallOnBlock(), CuttingTool(1e4, np.zeros(3)), 55e-6
    down = ramp((0.0, 0.0, -4e-3), 0.3)
    devices = np.concatenate([down, down[-1] + ramp((5e-3, 0.0, 0.0), 2.5)])
    _, pull, cut = lead(tool, law.force, step * np.round(devices / step))
    late = slice(-1500, None)
    np.testing.assert_allclose(
        pull[late].mean(axis=0), cut[late].mean(axis=0), atol=0.1 * np.linalg.norm(pull[-1])
    )
    assert np.linalg.norm(cut[late], axis=1).max() < 3.0 * np.linalg.norm(pull[late], axis=1).mean()
    assert np.abs(np.diff(pull[late], axis=0)).max() < 2.0 * 1e4 * step


@pytest.mark.parametrize("damping", [0.0, 100.0])
def test_spring_damper_edge_and_resistance_balance_in_every_step(damping):
    """Spring, damper, edge force and resistance balance in every step.

    k (d - s) + b (V - s / T) = E + C s / T in closed form; the smoothed velocity V contains 1 in
    200 of the first step.
    """
    stiffness, drag, edge = 1e4, 5e3, 8.0
    tool, response = CuttingTool(stiffness, np.zeros(3), damping_N_s_m=damping), Response.empty(1)
    response.resistance[2], response.edge[2] = drag, edge
    gone = pace = 0.0
    for _ in range(3):
        step = (stiffness * (2e-3 - gone) + damping * pace - edge) / (
            stiffness + (drag + damping) / STEP_S
        )
        gone, pace = gone + step, pace + (step / STEP_S - pace) / 200.0
        tip = tool.follow(2e-3 * DOWN, UPRIGHT, response, DOWN, STEP_S)
        np.testing.assert_allclose(-tip[2], gone, rtol=1e-12)


def test_what_a_tool_has_felt_fades_and_then_it_is_free():
    tool, response, nothing = CuttingTool(1e4, np.zeros(3)), Response.empty(1), Response.empty(1)
    response.resistance[2] = 1e5
    tool.follow(1e-3 * DOWN, UPRIGHT, response, DOWN, STEP_S)
    steps = -np.diff(
        [tool.follow(1e-3 * DOWN, UPRIGHT, nothing, DOWN, STEP_S)[2] for _ in range(150)]
    )
    assert steps[0] < 2e-6 and (steps >= 0.0).all() and not tool.driven
    np.testing.assert_array_equal(
        tool.follow(2e-3 * DOWN, UPRIGHT, nothing, DOWN, STEP_S), 2e-3 * DOWN
    )


def test_a_resting_tool_passes_the_pull_on():
    """Below the edge force the tissue answers the spring in full."""
    tool, response = CuttingTool(1e4, np.zeros(3)), Response.empty(1)
    response.edge[2], response.edge[5] = 8.0, 0.02
    device = np.array([1e-4, 0.0, -4e-4])
    np.testing.assert_array_equal(tool.follow(device, UPRIGHT, response, DOWN, STEP_S), np.zeros(3))
    np.testing.assert_allclose(tool.push, [*(1e4 * device), 0.0, 0.0, 0.5 * -0.02])
