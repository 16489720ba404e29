"""Tool that a thrust pushes into bone, against the balance of forces.

The balance is integrated separately from closed forms.
"""

from math import pi

import numpy as np
import pytest
from scipy.optimize import brentq

import tissue
from tissue.materials.constants import cutting_coefficients

DT_S, MASS_KG, MAX_MM_S, START_MM = 1e-3, 0.5, 5.0, 0.5
TOOLS = {
    "flat reamer": {
        "kind": "flat-reamer",
        "diameter_mm": 12.0,
        "length_mm": 10.0,
        "flutes": 4,
        "spin_rpm": 500.0,
    },
    "end mill": {
        "kind": "cylinder",
        "diameter_mm": 6.0,
        "length_mm": 10.0,
        "flutes": 4,
        "spin_rpm": 3000.0,
    },
    "ball": {"kind": "ball-burr", "diameter_mm": 5.0, "flutes": 6, "spin_rpm": 10000.0},
    "drill": {
        "kind": "twist-drill",
        "diameter_mm": 3.2,
        "length_mm": 20.0,
        "flutes": 2,
        "spin_rpm": 1000.0,
    },
}
BONE = cutting_coefficients("bone")


def pushed(tool, thrust_N, *, duration_s=0.35, max_mm_s=MAX_MM_S):
    """A block of 16 x 16 x 6 mm under a tool that starts half a millimetre above it."""
    return tissue.simulate(
        tissue.Scene.model_validate(
            {
                "name": "pushed",
                "anatomy": {"kind": "block", "size_mm": [16.0, 16.0, 6.0]},
                "voxels": {"spacing_mm": 0.2},
                "tool": tool,
                "motion": {
                    "kind": "thrust",
                    "thrust_N": thrust_N,
                    "start_mm": [0, 0, START_MM],
                    "depth_mm": 2.0,
                    "max_feed_mm_s": max_mm_s,
                },
                "duration_s": duration_s,
            }
        )
    )


@pytest.mark.parametrize(
    ("name", "thrust_N"),
    [
        ("flat reamer", 40.0),
        ("flat reamer", 60.0),
        ("end mill", 60.0),
        ("ball", 40.0),
        ("drill", 60.0),
    ],
)
def test_force_never_exceeds_the_thrust_and_what_stops_the_mass(name, thrust_N):
    """The force never exceeds the thrust and the force that stops the mass.

    In every tick m (v - v_before) / dt = thrust - F where the feed limit does not act, and F is
    below it where it does.
    """
    run = pushed(TOOLS[name], thrust_N)
    force = run.trace["model_force_z_N"]
    speed = -1e-3 * run.trace["velocity_z_mm_s"]
    before = np.concatenate([[0.0], speed[:-1]])
    assert force.max() <= thrust_N + MASS_KG * MAX_MM_S * 1e-3 / DT_S
    assert (force <= thrust_N + MASS_KG * before / DT_S + 1e-6).all()
    moving = (speed > 0.0) & (speed < 1e-3 * MAX_MM_S * (1.0 - 1e-9))
    inertia = MASS_KG * (speed - before) / DT_S
    np.testing.assert_allclose((force + inertia)[moving], thrust_N, rtol=1e-6)
    # The pose is that of the speed within a hundredth, but for the ticks of a landing on a flat
    # end, where the force jumps.
    travelled = -np.diff(run.trace["tool_z_mm"]) / 1e3 / DT_S
    off = np.abs(travelled - speed[1:]) > 0.0101 * np.maximum(speed[1:], travelled) + 1e-9
    assert off.sum() <= 4 and travelled.min() >= 0.0


def plunged_N(radius_m, flutes, omega, depth_m, speed_m_s):
    """Axial force on a ball whose lowest point is so deep, by integrating its elements; strength 1.

    At polar angle a: radius R sin a, advance v cos a, area 2 pi R^2 sin a da, cutting edge N / (2
    pi R sin a) per area.
    """
    if depth_m <= 0.0:
        return 0.0
    top = np.arccos(max(1.0 - depth_m / radius_m, 0.0))
    x, w = np.polynomial.legendre.leggauss(12)
    a, weight = 0.5 * top * (x + 1.0), 0.5 * top * w
    chip = speed_m_s * np.cos(a) * 2.0 * pi / (flutes * omega)
    radial = (BONE.radial_chip_Pa * chip + BONE.radial_edge_N_m) * np.cos(a)
    axial = BONE.axial_chip_Pa * chip + BONE.axial_edge_N_m
    return float(flutes * radius_m * ((radial - axial) * weight).sum())


def integrated(thrust_N, force_N, ticks):
    """Return depths [m] and forces [N] of implicit Euler ticks.

    Each is solved by bisection for the force at its own end.
    """
    depth, speed, rows = -1e-3 * START_MM, 0.0, []
    for _ in range(ticks):

        def excess(v, depth=depth, speed=speed):
            return MASS_KG * (v - speed) / DT_S + force_N(depth + v * DT_S, v) - thrust_N

        top = 1e-3 * MAX_MM_S
        speed = (
            top
            if excess(top) <= 0.0
            else (brentq(excess, 0.0, top, xtol=1e-12) if excess(0.0) < 0.0 else 0.0)
        )
        depth += speed * DT_S
        rows.append((depth, force_N(depth, speed)))
    return np.array(rows).T


@pytest.mark.parametrize("thrust_N", [pytest.param(25.0, marks=pytest.mark.slow), 40.0])
def test_ball_follows_the_balance_integrated_from_its_elements(thrust_N):
    """A ball follows the balance integrated from its elements.

    The depth is within 1 % of 2 mm at all times, the force within 3 % of the thrust: 0.2 mm voxels,
    6000 elements.
    """
    tool = TOOLS["ball"]
    run = pushed(tool, thrust_N, duration_s=0.5)
    omega = tool["spin_rpm"] * 2.0 * pi / 60.0
    depth, force = integrated(
        thrust_N, lambda d, v: plunged_N(2.5e-3, tool["flutes"], omega, d, v), len(run.trace.rows)
    )
    np.testing.assert_allclose(-run.trace["tool_z_mm"], 1e3 * depth, atol=0.02)
    np.testing.assert_allclose(run.trace["model_force_z_N"], force, atol=0.03 * thrust_N)
    assert force.max() > 0.9 * thrust_N


def test_flat_end_cuts_at_the_feed_of_the_closed_form():
    """A flat end cuts at the feed of the closed form.

    Over a flat end the edges' lengths add up to N R: F = N R ((K_rc - K_ac) h + K_re - K_ae), and
    torque N R^2 / 2.
    """
    tool, thrust = TOOLS["end mill"], 60.0
    run = pushed(tool, thrust)
    chip = (thrust / (tool["flutes"] * 3e-3) - BONE.radial_edge_N_m + BONE.axial_edge_N_m) / (
        BONE.radial_chip_Pa - BONE.axial_chip_Pa
    )
    feed_mm_s = 1e3 * chip * tool["flutes"] * tool["spin_rpm"] / 60.0
    torque = (
        0.5 * tool["flutes"] * 3e-3**2 * (BONE.tangential_chip_Pa * chip + BONE.tangential_edge_N_m)
    )
    assert -run.trace["velocity_z_mm_s"][-1] == pytest.approx(feed_mm_s, rel=0.01)
    torques = np.abs(run.trace["model_torque_z_Nm"])
    assert torques[-1] == pytest.approx(torque, rel=0.01)
    assert torques.max() < 1.1 * torque  # no spike at the first contact
