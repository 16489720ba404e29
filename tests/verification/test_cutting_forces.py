"""Cutting forces against the mechanics they stand for."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest
from scipy.optimize import brentq

import tissue
from meshes.shapes.anatomy import cortical_block
from meshes.voxels.voxelise import voxelise
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr, cylinder
from tissue.haptics.loop.vibration import BAND_LIMIT_HZ, Vibration
from tissue.materials.constants import CuttingCoefficients, cutting_coefficients
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import ToolMotion

BONE = cutting_coefficients("bone")
SHARP = replace(BONE, tangential_edge_N_m=0.0, radial_edge_N_m=0.0, axial_edge_N_m=0.0)


def pull(model, start_m, direction, *, length_m, feed_m_s, step_m, rotation=None):
    """Draw a tool along a line; wrench, removal rate and removed volume at every tick."""
    motion = ToolMotion(speed_m_s=feed_m_s, rotation=np.eye(3) if rotation is None else rotation)
    motion.heading[0] = np.asarray(direction, float) / np.linalg.norm(direction)
    motion.tip_m[:] = start_m
    model.place(motion)
    rows = []
    for travel in np.arange(0.0, length_m, step_m):
        motion.tip_m[:] = np.asarray(start_m) + travel * motion.heading[0]
        model.advance(motion)
        response = model.respond(motion)
        rows.append([*response.wrench, response.removal_rate_m3_s, model.removed_m3.sum()])
    return np.array(rows)


# Altintas slot milling, case 18: N = 4, depth 1 mm, 0.02 mm a tooth, K_t, K_r = 150, 60 N/mm2,
# K_te, K_re = 5, 4 N/mm.
TEETH, DEPTH_M, CHIP_M = 4, 1e-3, 2e-5
SLOT = CuttingCoefficients(150e6, 60e6, 0.0, 5e3, 4e3, 0.0, 1800.0, 1.0)
MEAN_X_N = -TEETH * DEPTH_M * (SLOT.radial_chip_Pa * CHIP_M / 4 + SLOT.radial_edge_N_m / pi)
MEAN_Y_N = TEETH * DEPTH_M * (SLOT.tangential_chip_Pa * CHIP_M / 4 + SLOT.tangential_edge_N_m / pi)
SPIN_RAD_S = -1000.0  # clockwise from the shank, as a milling cutter turns
FEED_M_S = CHIP_M * TEETH * abs(SPIN_RAD_S) / (2 * pi)


def test_closed_form_of_the_slot_is_the_published_example():
    assert pytest.approx((-6.292958, 9.366198), abs=1e-6) == (MEAN_X_N, MEAN_Y_N)


def test_slot_forces_on_voxels():
    """The forces in the same slot, cut out of voxels, agree within 2 %."""
    volume = voxelise(cortical_block(size_mm=(14, 7.2, 1.6)), spacing_m=1e-4)
    cutter = Cutter(cylinder(diameter_m=6e-3, length_m=3e-3), TEETH, SPIN_RAD_S)
    model = BoneModel(volume, cutter, (SLOT,))
    rows = pull(
        model, (-6.3e-3, 0, -DEPTH_M), (1, 0, 0), length_m=9e-3, feed_m_s=FEED_M_S, step_m=1e-5
    )
    force = rows[500:, :3].mean(axis=0)
    print(
        f"\nslot on voxels: {force[0]:.4f}, {force[1]:.4f} N; closed form {MEAN_X_N:.4f}, "
        f"{MEAN_Y_N:.4f} N"
    )
    assert force[:2] == pytest.approx((MEAN_X_N, MEAN_Y_N), rel=0.02)
    assert abs(force[2]) < 0.02 * MEAN_Y_N  # the flat end does not advance


@pytest.fixture(scope="module")
def sharp_slot():
    """A ball draws a slot with sharp edges: wrench, removal rate and volume over time."""
    volume = voxelise(cortical_block(size_mm=(12, 7, 4)), spacing_m=1e-4)
    cutter = Cutter(ball_burr(diameter_m=6e-3), 6, 1000.0)
    model = BoneModel(volume, cutter, (SHARP,))
    rows = pull(model, (-4e-3, 2e-5, -1.2e-3), (1, 0, 0), length_m=5e-3, feed_m_s=2e-3, step_m=2e-6)
    return cutter, rows


def test_power_is_specific_energy_times_removal_rate(sharp_slot):
    """T omega = K_tc MRR with the volume rate booked in voxels: 2 %."""
    cutter, rows = sharp_slot
    steady = slice(1000, 2400)
    removal_rate = (rows[steady][-1, 7] - rows[steady][0, 7]) / (len(rows[steady]) - 1) / 1e-3
    power = np.abs(rows[steady, 5]).mean() * cutter.spin_rad_s
    print(f"\npower {power:.5f} W, u MRR {BONE.tangential_chip_Pa * removal_rate:.5f} W")
    assert power == pytest.approx(BONE.tangential_chip_Pa * removal_rate, rel=0.02)


def test_element_removal_rate_integrates_to_the_voxel_volume(sharp_slot):
    """Elements and voxels take the same volume out: 1 %, entry into solid bone included."""
    _, rows = sharp_slot
    from_elements = rows[1:, 6].sum() * 1e-3
    assert from_elements == pytest.approx(rows[-1, 7] - rows[0, 7], rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("depth_m", [1e-4, 2e-4, 5e-4])
def test_shallow_pass_over_a_cut_bottom_keeps_the_balance(depth_m):
    """A shallow pass over a cut bottom keeps the balance.

    A second pass, one to five voxels deeper than the first, removes by elements the volume that it
    removes in voxels, within 3 %. One voxel of depth is the worst case: the fill resolves such a
    pass by a single layer of voxels.
    """
    volume = voxelise(cortical_block(size_mm=(10, 6, 2)), spacing_m=1e-4)
    model = BoneModel(
        volume, Cutter(ball_burr(diameter_m=6e-3), 6, 1000.0), (BONE,), shell_spacing_m=1e-4
    )
    pull(model, (-3e-3, 0, -3e-4), (1, 0, 0), length_m=6e-3, feed_m_s=5e-3, step_m=5e-6)
    rows = pull(
        model, (3e-3, 0, -3e-4 - depth_m), (-1, 0, 0), length_m=6e-3, feed_m_s=5e-3, step_m=5e-6
    )
    first = 400
    from_elements = rows[first:, 6].sum() * 1e-3
    assert from_elements == pytest.approx(rows[-1, 7] - rows[first - 1, 7], rel=0.03)


def test_mirrored_scene_gives_mirrored_forces():
    """Mirrored at y = 0 with the spin reversed: forces mirror, torques mirror as axial vectors.

    The elements' spiral is not its own mirror image: with 12,000 of them the two agree within 0.5
    %.
    """
    results = []
    for side in (1.0, -1.0):
        volume = voxelise(cortical_block(size_mm=(9, 9, 2)), spacing_m=1e-4)
        model = BoneModel(
            volume,
            Cutter(ball_burr(diameter_m=4e-3), 6, side * 1000.0),
            (BONE,),
            shell_spacing_m=6e-5,
        )
        rows = pull(
            model,
            (-1.5e-3, 0, -5e-4),
            (1.0, 0.3 * side, 0),
            length_m=3e-3,
            feed_m_s=5e-3,
            step_m=5e-6,
        )
        results.append(rows[300:, :6].mean(axis=0))
    mirrored = results[0] * np.array([1, -1, 1, -1, 1, -1])
    assert results[1][:3] == pytest.approx(mirrored[:3], abs=5e-3 * np.linalg.norm(mirrored[:3]))
    assert results[1][3:] == pytest.approx(mirrored[3:], abs=5e-3 * np.linalg.norm(mirrored[3:]))


def test_force_grows_with_density_as_the_power_law():
    forces = []
    for density in (600.0, 1800.0):
        volume = voxelise(
            cortical_block(size_mm=(6, 6, 1.6), density_kg_m3=density), spacing_m=1e-4
        )
        model = BoneModel(volume, Cutter(ball_burr(diameter_m=4e-3), 6, 1000.0), (BONE,))
        rows = pull(model, (0, 0, 0), (0, 0, -1), length_m=8e-4, feed_m_s=1e-3, step_m=2e-6)
        forces.append(np.linalg.norm(rows[-1, :3]))
    assert forces[1] / forces[0] == pytest.approx(3.0**BONE.density_exponent, rel=1e-5)


# glenoid reaming, 300-1000 rpm, low confidence
PUBLISHED_TORQUE_NM, PUBLISHED_THRUST_N = (0.2, 2.0), (20.0, 100.0)


COARSE = {
    "voxels.spacing_mm": 0.2,
    "motion.points_mm": [[0, 0, -0.1], [0, 0, -2.0]],
    "motion.feed_mm_s": 2.0,
    "tool.spin_rpm": 2000.0,
    "duration_s": 1.0,
}
"""Changes to four times the scene's feed and spin.

Chip thickness and force are unchanged, in a quarter of the ticks.
"""


def steady(**changes):
    """Return thrust and torque [N, N m] near full depth.

    They push back, and act against a tool that turns clockwise from above.
    """
    run = tissue.simulate(tissue.load_scene("glenoid", COARSE | changes))
    late = slice(-120, -60)
    return run.trace["model_force_z_N"][late].mean(), run.trace["model_torque_z_Nm"][late].mean()


def test_thrust_and_torque_lie_in_the_published_range():
    thrust, torque = steady()
    print(f"\nglenoid near 2 mm: thrust {thrust:.1f} N, torque {torque:.3f} N m")
    assert PUBLISHED_THRUST_N[0] < thrust < PUBLISHED_THRUST_N[1]
    assert PUBLISHED_TORQUE_NM[0] < torque < PUBLISHED_TORQUE_NM[1]


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
    # end, where the force jumps. Below the minimum chip thickness the tool creeps by 3 nm a tick,
    # and a landing takes up to five ticks until it does. The poses of the last three of them differ
    # by 0.1 um at most.
    travelled = -np.diff(run.trace["tool_z_mm"]) / 1e3 / DT_S
    off = np.abs(travelled - speed[1:]) > 0.0101 * np.maximum(speed[1:], travelled) + 1e-9
    assert off.sum() <= 5 and travelled.min() >= 0.0
    late = np.flatnonzero(off)[2:]
    assert (np.abs(travelled - speed[1:])[late] * DT_S < 1e-7).all()


def plunged_N(radius_m, flutes, omega, depth_m, speed_m_s):
    """Axial force on a ball whose lowest point is so deep, by integrating its elements; strength 1.

    At polar angle a: radius R sin a, advance v cos a, area 2 pi R^2 sin a da, cutting edge N / (2
    pi R sin a) per area. Below the minimum chip thickness the edge force is proportional to the
    chip thickness.
    """
    if depth_m <= 0.0:
        return 0.0
    top = np.arccos(max(1.0 - depth_m / radius_m, 0.0))
    x, w = np.polynomial.legendre.leggauss(12)
    a, weight = 0.5 * top * (x + 1.0), 0.5 * top * w
    chip = speed_m_s * np.cos(a) * 2.0 * pi / (flutes * omega)
    edge = BONE.radial_edge_N_m * np.minimum(chip / BONE.minimum_chip_m, 1.0)
    radial = (BONE.radial_chip_Pa * chip + edge) * np.cos(a)
    return float(flutes * radius_m * (radial * weight).sum())


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

    Over a flat end the edges' lengths add up to N R: F = N R (K_rc h + K_re), and torque N R^2 / 2.
    """
    tool, thrust = TOOLS["end mill"], 60.0
    run = pushed(tool, thrust)
    chip = (thrust / (tool["flutes"] * 3e-3) - BONE.radial_edge_N_m) / BONE.radial_chip_Pa
    assert chip > BONE.minimum_chip_m
    feed_mm_s = 1e3 * chip * tool["flutes"] * tool["spin_rpm"] / 60.0
    torque = (
        0.5 * tool["flutes"] * 3e-3**2 * (BONE.tangential_chip_Pa * chip + BONE.tangential_edge_N_m)
    )
    assert -run.trace["velocity_z_mm_s"][-1] == pytest.approx(feed_mm_s, rel=0.01)
    torques = np.abs(run.trace["model_torque_z_Nm"])
    assert torques[-1] == pytest.approx(torque, rel=0.01)
    assert torques.max() < 1.1 * torque  # no spike at the first contact


RATE_HZ, TICKS, MEAN_N, SHARE = 1000.0, 4000, 2.0, 0.2


TIMES_S = np.arange(TICKS) / RATE_HZ


def slow_amplitude(force, below_Hz=100.0):
    """Return the largest amplitude [N] of the force's spectrum between 0 and a frequency.

    The mean is left out.
    """
    spectrum = np.abs(np.fft.rfft(force - force.mean())) * 2.0 / len(force)
    return spectrum[np.fft.rfftfreq(len(force), 1.0 / RATE_HZ) < below_Hz].max()


def rendered(passing_Hz):
    vibration = Vibration(passing_Hz, share=SHARE, step_s=1.0 / RATE_HZ)
    return MEAN_N * (1.0 + np.array([vibration.factor(tick) for tick in range(TICKS)]))


@pytest.mark.parametrize("passing_Hz", [40_003.0, 1005.0, 2997.0])
def test_plain_sampling_aliases_and_ours_does_not(passing_Hz):
    sampled = MEAN_N * (1.0 + SHARE * np.cos(2.0 * np.pi * passing_Hz * TIMES_S))
    print(
        f"\n{passing_Hz:g} Hz: slow force {slow_amplitude(sampled):.3f} N sampled, "
        f"{slow_amplitude(rendered(passing_Hz)):.1e} N rendered"
    )
    assert slow_amplitude(sampled) == pytest.approx(SHARE * MEAN_N, rel=0.01)
    assert slow_amplitude(rendered(passing_Hz)) < 1e-9


def test_mean_and_strength_are_kept():
    force = rendered(40_000.0)
    assert force.mean() == pytest.approx(MEAN_N, rel=1e-12)
    assert np.sqrt(2.0) * force.std() == pytest.approx(SHARE * MEAN_N, rel=1e-9)


def test_slow_passing_keeps_its_own_frequency():
    assert Vibration(33.3, share=0.1, step_s=1e-3).frequency_Hz == 33.3
    assert Vibration(40_000.0, share=0.1, step_s=1e-3).frequency_Hz == BAND_LIMIT_HZ
    assert BAND_LIMIT_HZ < 0.5 * RATE_HZ
