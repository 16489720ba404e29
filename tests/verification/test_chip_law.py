"""Cutting law from vanishing chips to thick ones: slope, limits and closed form."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest
from scipy.optimize import brentq

import tissue
from meshes.voxels.volume import density_volume
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr, cylinder
from tissue.environments.drilling import HAND_KG, TOP_SPEED_M_S, Drilling
from tissue.materials.constants import CuttingCoefficients, effective_chip
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import TICK_S, ToolMotion
from tissue.motion import thrust

RADIUS_M, FLUTES, SPIN_RAD_S = 3e-3, 4, 100.0 * pi
LEAST_M = 1e-6
LAW = CuttingCoefficients(150e6, 60e6, 10e6, 5e3, 4e3, 1e3, 1000.0, 1.0, 0.0, LEAST_M, 1e-4)
LINEAR = replace(LAW, minimum_chip_m=0.0)
EXPONENTS = (0.0, 0.3)
END_M = FLUTES * RADIUS_M
"""Length of edge on a flat end, N R [m]: N / (2 pi r) integrated over its area."""
CHIP_PER_SPEED_S = 2.0 * pi / (FLUTES * SPIN_RAD_S)


def model_of(law, profile):
    """A tool in bone of the reference density without end."""
    volume = density_volume(
        np.full((40,) * 3, 1000.0), spacing_mm=0.2, origin_mm=(-4.0, -4.0, -4.0)
    )
    return BoneModel(volume, Cutter(profile, FLUTES, SPIN_RAD_S), (law,))


def plunging(model, chip_m):
    """Response to a plunge whose feed per tooth is a chip thickness."""
    motion = ToolMotion(speed_m_s=chip_m / CHIP_PER_SPEED_S)
    motion.tip_m[2] = -1e-3
    motion.heading[0] = (0.0, 0.0, -1.0)
    return model.respond(motion)


def law_N(law, chip_m):
    """Axial force on a flat end at a chip thickness [N], in double precision."""
    effective, share = effective_chip(
        np.array([chip_m]), law.size_exponent, law.minimum_chip_m, law.reference_chip_m
    )
    chip_Pa = law.radial_chip_Pa - law.axial_chip_Pa
    edge_N_m = law.radial_edge_N_m - law.axial_edge_N_m
    return END_M * float(chip_Pa * effective[0] + edge_N_m * share[0])


@pytest.fixture(scope="module", params=EXPONENTS)
def flat_end(request):
    """A flat end and its law."""
    law = replace(LAW, size_exponent=request.param)
    return law, model_of(law, cylinder(diameter_m=2.0 * RADIUS_M, length_m=2e-3))


@pytest.mark.parametrize("share", [1e-6, 0.01, 0.5, 0.99, 1.01, 3.0, 30.0])
def test_force_on_a_flat_end_is_the_law_and_its_slope(flat_end, share):
    """The force is that of the law within 1e-5, rounding of single precision.

    `resistance` is the derivative of the law by the speed, by a finite difference of the law.
    """
    law, model = flat_end
    chip_m = share * LEAST_M
    response = plunging(model, chip_m)
    assert response.wrench[2] == pytest.approx(law_N(law, chip_m), rel=1e-5)
    step_m = 1e-4 * chip_m
    slope = (law_N(law, chip_m + step_m) - law_N(law, chip_m - step_m)) / (2.0 * step_m)
    assert response.resistance[2] == pytest.approx(slope * CHIP_PER_SPEED_S, rel=1e-5)


@pytest.mark.parametrize("exponent", EXPONENTS)
@pytest.mark.parametrize("share", [0.3, 1.0, 4.0])
def test_resistance_is_the_finite_difference_of_the_force(exponent, share):
    """A ball's elements have chips from 0 to the feed, on both sides of h_min.

    The speed changes by 0.5 %. The force of single precision is off by 1e-6 of itself, so the slope
    by 2e-4. Where the feed is h_min, elements cross it: the difference is one-sided there.
    """
    model = model_of(replace(LAW, size_exponent=exponent), ball_burr(diameter_m=4e-3))
    chip_m = share * LEAST_M
    low_m, high_m = 0.995 * chip_m, (1.0 if share == 1.0 else 1.005) * chip_m
    low, high = (plunging(model, each).wrench.copy() for each in (low_m, high_m))
    found = (high - low) / (high_m - low_m) * CHIP_PER_SPEED_S
    middle = plunging(model, 0.5 * (low_m + high_m)).resistance
    np.testing.assert_allclose(found[[2, 5]], middle[[2, 5]], rtol=2e-3)


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_force_goes_to_zero_linearly_with_the_speed(exponent):
    model = model_of(replace(LAW, size_exponent=exponent), ball_burr(diameter_m=4e-3))
    chips_m = LEAST_M * np.array([1e-6, 1e-4, 0.01, 0.9])
    per_chip = [plunging(model, chip_m).wrench / chip_m for chip_m in chips_m]
    assert np.linalg.norm(per_chip[0]) > 0.0
    for each in per_chip[1:]:
        np.testing.assert_allclose(each[[2, 5]], per_chip[0][[2, 5]], rtol=1e-5)
    assert not plunging(model, 0.0).edge.any()


def test_lipschitz_constant_is_the_edge_coefficient_over_h_min_plus_the_chip_coefficient():
    """Of the force over the speed: N R (K_e / h_min + K) times the chip thickness per speed.

    With a size effect, K counts at h_min. The law is concave, so the constant is the slope at rest,
    and the kernel has it there.
    """
    for exponent in EXPONENTS:
        law = replace(LAW, size_exponent=exponent)
        scale = (LEAST_M / law.reference_chip_m) ** -exponent
        edge_N_m = law.radial_edge_N_m - law.axial_edge_N_m
        chip_Pa = law.radial_chip_Pa - law.axial_chip_Pa
        constant = END_M * (edge_N_m / LEAST_M + chip_Pa * scale)
        chips_m = np.concatenate([[0.0], np.geomspace(1e-10, 1e-4, 300)])
        slopes = np.diff([law_N(law, each) for each in chips_m]) / np.diff(chips_m)
        assert slopes.max() == pytest.approx(constant, rel=1e-9)
        assert (np.diff(slopes) <= 1e-6 * constant).all()
        flat = model_of(law, cylinder(diameter_m=2.0 * RADIUS_M, length_m=2e-3))
        at_rest = plunging(flat, 0.0).resistance[2]
        assert at_rest == pytest.approx(constant * CHIP_PER_SPEED_S, rel=1e-5)


def test_without_both_keys_the_law_is_linear():
    """In double precision to 1e-12; in the kernel the tangent is the same, bit for bit."""
    chips_m = np.concatenate([[0.0], np.geomspace(1e-12, 1e-3, 200)])
    effective, share = effective_chip(chips_m, 0.0, 0.0, 1e-4)
    np.testing.assert_allclose(effective, chips_m, rtol=1e-12)
    np.testing.assert_array_equal(share, 1.0)
    # A layer that is not cut has a minimum chip thickness, so that the kernel gets the speed.
    volume = density_volume(
        np.full((40,) * 3, 1000.0), spacing_mm=0.2, origin_mm=(-4.0, -4.0, -4.0)
    )
    volume = replace(volume, layer_names=(*volume.layer_names, "other"))
    cutter = Cutter(ball_burr(diameter_m=4e-3), FLUTES, SPIN_RAD_S)
    linear, given = (BoneModel(volume, cutter, (LINEAR, each)) for each in (LINEAR, LAW))
    for chip_m in (1e-9, 1e-6, 1e-4):
        found, wanted = plunging(given, chip_m), plunging(linear, chip_m)
        for name in ("resistance", "edge", "wrench"):
            np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name))
    assert wanted.edge.any()


TOOLS = {
    "mill": {"kind": "cylinder", "diameter_mm": 6.0, "length_mm": 10.0, "flutes": 4},
    "drill": {
        "kind": "twist-drill",
        "diameter_mm": 3.2,
        "length_mm": 20.0,
        "flutes": 2,
        "web_mm": 0.0,
        "helix_deg": 30.0,
    },
}
START_MM = {"mill": 0.2, "drill": -1.5}
"""The flat end lands on the block. The lips of the drill start in their hole, all engaged."""
SPIN_RPM, MASS_KG = 3000.0, 0.5
BONE = {
    "tangential_chip_N_mm2": 150.0,
    "radial_chip_N_mm2": 60.0,
    "axial_chip_N_mm2": 0.0,
    "tangential_edge_N_mm": 5.0,
    "radial_edge_N_mm": 4.0,
    "axial_edge_N_mm": 0.0,
}


def pushed(tool, thrust_N, law, monkeypatch):
    """A run of a tool under thrust into a flat block, and the poses tried in each of its ticks."""
    tried = []
    begin = thrust.SpeedSearch.begin
    narrow = thrust.SpeedSearch._narrow

    def begun(search, *given, **more):
        tried.append(1)
        begin(search, *given, **more)

    def narrowed(search, balanced):
        before = search.tried
        narrow(search, balanced)
        tried[-1] += search.tried != before

    monkeypatch.setattr(thrust.SpeedSearch, "begin", begun)
    monkeypatch.setattr(thrust.SpeedSearch, "_narrow", narrowed)
    run = tissue.simulate(
        tissue.Scene.model_validate(
            {
                "name": "pushed",
                "anatomy": {"kind": "block", "size_mm": [12.0, 12.0, 6.0]},
                "voxels": {"spacing_mm": 0.2},
                "tool": {**TOOLS[tool], "spin_rpm": SPIN_RPM},
                "cutting": BONE | law,
                "motion": {
                    "kind": "thrust",
                    "thrust_N": thrust_N,
                    "start_mm": [0, 0, START_MM[tool]],
                    "depth_mm": 4.0,
                    "max_feed_mm_s": 20.0,
                },
                "duration_s": 0.4,
            }
        )
    )
    return run, np.array(tried)


def balanced_mm_s(tool, thrust_N, law):
    """Speed at which the law over the tool's whole end balances a thrust [mm/s].

    The end advances evenly: a flat end by the speed, lips by its share sin(half point angle). Their
    length per radius is its inverse, and so are the axial parts of their loads.
    """
    shape = TOOLS[tool]
    tilt = 1.0 if tool == "mill" else np.sin(np.radians(118.0 / 2.0))
    edge_m = shape["flutes"] * 0.5e-3 * shape["diameter_mm"]
    least_m = 1e-6 * law["minimum_chip_um"]
    exponent = law["size_exponent"]

    def excess(chip_m):
        effective, share = effective_chip(np.array([chip_m]), exponent, least_m, 1e-4)
        return edge_m * float(60e6 * effective[0] + 4e3 * share[0]) - thrust_N

    chip_m = brentq(excess, 1e-12, 1e-3, xtol=1e-15)
    return 1e3 * chip_m / tilt * shape["flutes"] * SPIN_RPM / 60.0


LAWS = {
    "refined": {"minimum_chip_um": 0.1, "size_exponent": 0.0},
    "size effect": {"minimum_chip_um": 1.0, "size_exponent": 0.3},
}


@pytest.mark.parametrize(
    ("tool", "thrust_N", "is_below", "law"),
    [
        ("mill", 60.0, False, "refined"),
        ("mill", 10.0, True, "size effect"),
        ("drill", 15.0, False, "size effect"),
        ("drill", 5.0, True, "refined"),
    ],
)
def test_a_constant_thrust_settles_at_the_speed_of_the_law(
    tool, thrust_N, is_below, law, monkeypatch
):
    """Speed and force end within 1 % of the closed form, above and below h_min, without ringing.

    In every tick the force balances thrust and inertia to rounding. The poses tried are as many as
    with the linear law, apart from the tick of the landing.
    """
    given = LAWS[law]
    run, tried = pushed(tool, thrust_N, given, monkeypatch)
    speed = -1e-3 * run.trace["velocity_z_mm_s"]
    force = run.trace["model_force_z_N"]
    wanted_mm_s = balanced_mm_s(tool, thrust_N, given)
    late = slice(-50, None)
    assert 1e3 * speed[late].mean() == pytest.approx(wanted_mm_s, rel=0.01)
    assert force[late].mean() == pytest.approx(thrust_N, rel=1e-3)
    chip_m = speed[-1] * 60.0 / (TOOLS[tool]["flutes"] * SPIN_RPM)
    assert bool(chip_m < 1e-6 * given["minimum_chip_um"]) is is_below
    if tool == "mill":  # the lips enter bone at 0.2 mm voxels all the time
        assert np.ptp(speed[late]) <= 1e-3 * speed[-1]
        after = speed[np.argmax(run.trace["contact_mm2"] > 0.0) + 3 :]
        assert (np.diff(after) >= -1e-9).all() or (np.diff(after) <= 1e-9).all()
    moving = (speed > 0.0) & (speed < 0.02 * (1.0 - 1e-9))
    before = np.concatenate([[0.0], speed[:-1]])
    inertia = MASS_KG * (speed - before) / TICK_S
    np.testing.assert_allclose((force + inertia)[moving], thrust_N, rtol=1e-9)
    linear = {"minimum_chip_um": 0.0, "size_exponent": 0.0}
    _, tried_before = pushed(tool, thrust_N, linear, monkeypatch)
    assert np.median(tried) == np.median(tried_before) == 1.0
    assert tried.max() <= max(tried_before.max(), 11)
    print(f"\n{tool} {thrust_N:g} N: {tried.mean():.3f} poses, linear {tried_before.mean():.3f}")


def test_a_bur_in_enamel_balances_the_thrust_of_its_hand():
    """The environment's force, thrust, damping and inertia sum to 1e-4 of the thrust."""
    env = Drilling()
    env.reset(seed=3)
    rows = []
    felt = env._felt

    def recorded(response):
        wrench = felt(response)
        rows.append((env._before, env._speed, wrench[2], env._thrust))
        return wrench

    env._felt = recorded
    for _ in range(20):
        env.step(np.array([0.2], np.float32))
    before, speed, force, pushes = np.array(rows)[200:].T
    damping = env.thrust_N / TOP_SPEED_M_S * speed
    excess = pushes - force - damping - HAND_KG * (speed - before) / TICK_S
    moving = (speed > 0.0) & (speed < TOP_SPEED_M_S) & (force > 0.0)
    assert moving.sum() > 100
    assert np.abs(excess[moving]).max() < 1e-4 * pushes[-1]
