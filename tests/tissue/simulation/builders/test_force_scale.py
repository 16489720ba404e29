"""Scale of forces at a device.

It follows from the forces of the script, the device's friction and its limit, and from the
stiffnesses of tissue, coupling and hand, in any frame.
"""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tissue import load_scene, simulate
from tissue.haptics.device.device import device_parameters
from tissue.simulation.builders.force_scale import (
    LARGEST_FORCE_RATIO,
    SMALLEST_FORCE_RATIO,
    ExpectedForce,
    Series,
    chosen_scale,
    cutting_force,
    expected_force,
    insertion_force,
    pressing_force,
)

LIBRARY = {
    "milling": cutting_force,
    "glenoid": cutting_force,
    "molar": cutting_force,
    "caries": cutting_force,
    "liver-press": pressing_force,
    "palpation": pressing_force,
    "needle": insertion_force,
    "incision": insertion_force,
}


@pytest.mark.parametrize("device", ["touch", "omni", "six-dof"])
@pytest.mark.parametrize("name", ["wall", *LIBRARY])
def test_a_script_s_force_fits_its_device(name, device):
    """The force of a script fits its device.

    It is at most half of the uncompressed range, and above friction where that allows it. Between
    both bounds the scale is the best one.
    """
    scene, limits = load_scene(name, {"device": device}), device_parameters(device)
    scale, why, d_prime = chosen_scale(scene)
    expected = expected_force(scene)
    low, high = SMALLEST_FORCE_RATIO * limits.friction_N, LARGEST_FORCE_RATIO * limits.force_limit_N
    assert scale * expected.force_N <= high * (1.0 + 1e-9)
    assert scale * expected.force_N >= 0.9 * min(low, high)
    best = Series.of(limits, scene.constants).best_scale(expected)
    # A scale is rounded down to two digits.
    assert 0.9 * best < scale <= best or not low < best * expected.force_N < high
    assert f"{expected.force_N:.3g} N" in why
    assert (d_prime is None) == (expected.stiffness_N_m == 0.0) == ("d′" not in why)
    assert chosen_scale(load_scene(name, {"device": device, "seed": 5, "hand": "novice"})) == (
        scale,
        why,
        d_prime,
    )


def test_the_best_scale_has_the_largest_sensitivity():
    series = Series(compliance_m_N=6.5e-3, threshold_N=0.475, weber=0.07)
    for expected in (
        ExpectedForce(50.0, 1e4, 5e-3),
        ExpectedForce(1.5, 300.0, 5e-3),
        ExpectedForce(0.4, 2000.0, 2e-4),
    ):
        best = series.best_scale(expected)
        scales = best * np.geomspace(0.01, 100.0, 2001)
        found = [series.sensitivity(expected, scale) for scale in scales]
        assert scales[np.argmax(found)] == pytest.approx(best, rel=0.01)
        # The same from two forces of springs in series.
        forces = [
            expected.depth_m
            / (1.0 / (best * share * expected.stiffness_N_m) + series.compliance_m_N)
            for share in (1.0, 1.001)
        ]
        change = (forces[1] - forces[0]) / np.log(1.001)
        felt = 0.07 * (forces[0] + series.threshold_N)
        assert series.sensitivity(expected, best) == pytest.approx(
            0.9538725 * np.log(1.3) * change / felt, rel=2e-3
        )


def test_a_motion_scale_replaces_a_force_scale():
    """A stiffness is felt as motion scale times force scale of it."""
    plain = expected_force(load_scene("wall"))
    series = Series.of(device_parameters("six-dof"), load_scene("wall").constants)
    double = plain._replace(stiffness_N_m=2.0 * plain.stiffness_N_m, depth_m=0.5 * plain.depth_m)
    scaled = {"device": "six-dof", "coupling.motion_scale": 2.0}
    assert chosen_scale(load_scene("wall", scaled)).factor == pytest.approx(
        series.best_scale(double), rel=0.1
    )


def test_a_device_with_more_friction_has_a_larger_scale():
    limits = device_parameters("six-dof")
    constants = load_scene("wall").constants
    expected = ExpectedForce(50.0, 1e4, 5e-3)
    scales = [
        Series.of(replace(limits, friction_N=friction), constants).best_scale(expected)
        for friction in (0.0, 0.1, 0.5)
    ]
    assert scales == sorted(scales) and scales[0] < scales[-1]


def test_the_summary_states_the_expected_sensitivity():
    run = simulate(load_scene("wall", {"device": "touch", "duration_s": 0.05}))
    assert run.summary["expected_d_prime"] == chosen_scale(run.scene).d_prime
    assert run.summary["force_scale"] == chosen_scale(run.scene).factor
    scripted = simulate(load_scene("milling", {"duration_s": 0.01}))
    assert "expected_d_prime" not in scripted.summary and "force_scale" not in scripted.summary


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        (
            "milling",
            {
                "voxels.spacing_mm": 0.2,
                "motion.points_mm": [[-5, 0, 0.05], [-5, 0, -0.2], [-2, 0, -0.2]],
            },
        ),
        ("glenoid", {"voxels.spacing_mm": 0.5, "motion.feed_mm_s": 2.0, "duration_s": 1.2}),
        ("needle", {"anatomy.interval_ms": 0.0}),
        ("incision", {"anatomy.interval_ms": 0.0}),
        (
            "liver-press",
            {
                "organ.law": "linear",
                "organ.order": 1,
                "anatomy.edge_mm": 30.0,
                "anatomy.touch_edge_mm": 8.0,
            },
        ),
    ],
)
def test_the_estimate_is_the_force_of_the_run(name, changes):
    """The estimate is the force of the run.

    It is within a fifth of the finely stepped run; for an organ, whose shape Hertz leaves out,
    within a factor of two.
    """
    scene = load_scene(name, changes)
    forces = np.linalg.norm(simulate(scene).trace.vectors("model_force", "N"), axis=1)
    if name == "liver-press":
        assert 0.5 < pressing_force(scene).force_N / forces.max() < 2.0
    else:
        assert LIBRARY[name](scene).force_N == pytest.approx(forces.max(), rel=0.2)


def test_it_does_not_depend_on_the_frame():
    """The slot along y, in a block turned with it."""
    along = {
        "motion.points_mm": [[-4, 0, 0.05], [-4, 0, -0.2], [4, 0, -0.2]],
        "voxels.spacing_mm": 0.2,
    }
    turned = {
        "motion.points_mm": [[0, -4, 0.05], [0, -4, -0.2], [0, 4, -0.2]],
        "voxels.spacing_mm": 0.2,
    }
    there = cutting_force(load_scene("milling", along | {"anatomy.size_mm": [20, 12, 6]})).force_N
    found = cutting_force(load_scene("milling", turned | {"anatomy.size_mm": [12, 20, 6]})).force_N
    assert found == pytest.approx(there, rel=0.02)


def test_a_file_that_changes_under_its_name_is_read_again(tmp_path):
    file = tmp_path / "block.stl"
    changes = {
        "anatomy.file": str(file),
        "anatomy.scale_mm": 1.0,
        "anatomy.centre_mm": [0, 0, 5],
        "anatomy.normal": [0, 0, 1],
        "device": "touch",
    }
    scales = []
    for width_mm in (30.0, 2.0):  # the burr has 6 mm
        trimesh.creation.box((width_mm, width_mm, 10.0)).export(file)
        scales.append(chosen_scale(load_scene("milling", changes))[0])
    assert scales[1] > 1.1 * scales[0]
