"""Scale of forces at a device.

It follows from the forces of the script, the device's friction and its limit, in any frame.
"""

import numpy as np
import pytest
import trimesh

from tissue import load_scene, simulate
from tissue.haptics.device.device import device_parameters
from tissue.simulation.builders.force_met import (
    LEAST,
    MOST,
    chosen_scale,
    cut,
    incised,
    pierced,
    pressed,
)

LIBRARY = {
    "milling": cut,
    "glenoid": cut,
    "molar": cut,
    "caries": cut,
    "liver-press": pressed,
    "palpation": pressed,
    "needle": pierced,
    "incision": incised,
}


@pytest.mark.parametrize("device", ["touch", "omni", "six-dof"])
@pytest.mark.parametrize("name", LIBRARY)
def test_a_script_s_force_fits_its_device(name, device):
    """The force of a script fits its device.

    It is at most half of the uncompressed range, above friction where that allows it, and 1 where 1
    fits.
    """
    scene, limits = load_scene(name, {"device": device}), device_parameters(device)
    scale, why = chosen_scale(scene)
    force = LIBRARY[name](scene)
    assert scale * force <= MOST * limits.force_limit_N * (1.0 + 1e-9)
    assert scale == 1.0 or scale * force >= 0.9 * min(
        LEAST * limits.friction_N, MOST * limits.force_limit_N
    )
    assert scale <= 1.0 or force < LEAST * limits.friction_N
    assert f"{force:.3g} N" in why
    assert (
        chosen_scale(scene)[0]
        == chosen_scale(load_scene(name, {"device": device, "seed": 5, "hand": "novice"}))[0]
    )


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
        ("liver-press", {"organ.order": 1, "anatomy.edge_mm": 30.0, "anatomy.touch_edge_mm": 8.0}),
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
        assert 0.5 < pressed(scene) / forces.max() < 2.0
    else:
        assert LIBRARY[name](scene) == pytest.approx(forces.max(), rel=0.2)


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
    there = cut(load_scene("milling", along | {"anatomy.size_mm": [20, 12, 6]}))
    assert cut(load_scene("milling", turned | {"anatomy.size_mm": [12, 20, 6]})) == pytest.approx(
        there, rel=0.02
    )


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
