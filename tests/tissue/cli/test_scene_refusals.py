"""What `tissue run` refuses of a scene, in one sentence with exit code 2."""

from types import SimpleNamespace

import pytest
from coarse_run import COARSE

from tissue.scene.load import scene_text

PARTS = "name, description, seed, duration_s, anatomy, voxels, tool, motion, keep_clear, cutting, output, device, stress, heat, organ, materials, fidelity"
CUTTERS = "ball-burr, pear-bur, cylinder, twist-drill, hemispherical-reamer, flat-reamer, sphere-probe, cylinder-probe, shell-probe, needle"
POINTS = "motion.points_mm must be a list of at least two points [x, y, z], got"


@pytest.mark.parametrize(
    ("override", "sentence"),
    [
        (
            "voxels.spacing=0.2",
            "voxels.spacing must be one of spacing_mm, removal, margin_mm, got spacing (did you mean spacing_mm?): "
            "rename or remove it",
        ),
        (
            "voxel.spacing_mm=0.2",
            f"voxel must be one of {PARTS}, got voxel (did you mean voxels?): rename or remove it",
        ),
        ("qqq=1", f"qqq must be one of {PARTS}, got qqq: rename or remove it"),
        ("voxels.spacing_mm=3", "voxels.spacing_mm must be greater than 0 and at most 2, got 3: use 0.1"),
        ("voxels.spacing_mm=0", "voxels.spacing_mm must be greater than 0 and at most 2, got 0: use 0.1"),
        ("voxels.spacing_mm=nan", "voxels.spacing_mm must be greater than 0 and at most 2, got nan: use 0.1"),
        ("voxels.spacing_mm=-inf", "voxels.spacing_mm must be greater than 0 and at most 2, got -inf: use 0.1"),
        (
            "voxels.spacing_mm=fine",
            "voxels.spacing_mm must be a number greater than 0 and at most 2, got fine: use 0.1",
        ),
        ('voxels.spacing_mm="1"', 'voxels.spacing_mm must be a number greater than 0 and at most 2, got "1": use 0.1'),
        (
            "voxels.spacing_mm=true",
            "voxels.spacing_mm must be a number greater than 0 and at most 2, got true: use 0.1",
        ),
        (
            "voxels=5",
            "voxels must be a table with entries such as spacing_mm, removal, margin_mm, got 5: see "
            "`tissue scenes NAME`",
        ),
        (
            "anatomy=5",
            "anatomy must be a table with entries such as kind, guide_hole_diameter_mm, guide_hole_depth_mm, got 5: see `tissue scenes NAME`",
        ),
        (
            "coupling.force_scale=autos",
            "device must be given for coupling.force_scale = autos: set device = touch, or remove it",
        ),
        (
            "coupling.force_scale=-1",
            "device must be given for coupling.force_scale = -1: set device = touch, or remove it",
        ),
        ("seed.low=1", "seed.low must name an entry of a part, got seed, which is a value: see `tissue scenes NAME`"),
        ("seed=-1", "seed must be at least 0 and below 9223372036854775808, got -1: use 0"),
        ("tool.flutes=2.0", "tool.flutes must be a whole number at least 1 and at most 200, got 2.0: use 4"),
        ("tool.flutes=201", "tool.flutes must be at least 1 and at most 200, got 201: use 4"),
        (
            "tool.kind=burr",
            f"tool.kind must be one of {CUTTERS}, got burr (did you mean ball-burr?): choose one of these",
        ),
        (
            "motion.kind=paht",
            "motion.kind must be one of path, thrust, replay, got paht (did you mean path?): choose one of these",
        ),
        ("motion.kind=thrust", "motion.thrust_N must be given, got nothing: add thrust_N = 40"),
        ("motion.kind=replay", 'motion.file must be given, got nothing: add file = "runs/glenoid/trace.csv"'),
        ("motion={}", "motion.kind must be given, got nothing: see `tissue scenes NAME`"),
        ("tool={}", "tool.kind must be given, got nothing: see `tissue scenes NAME`"),
        ("motion.points_mm=[[0,0,1]]", f"{POINTS} [[0, 0, 1]]: use [[0, 0, 0.5], [0, 0, -2]]"),
        ("motion.points_mm=7", f"{POINTS} 7: use [[0, 0, 0.5], [0, 0, -2]]"),
        ("motion.points_mm=[[0,0],[1,1,1]]", f"{POINTS} [[0, 0], [1, 1, 1]]: use [[0, 0, 0.5], [0, 0, -2]]"),
        ("motion.points_mm=[[0,0,nan],[1,1,1]]", f"{POINTS} [[0, 0, nan], [1, 1, 1]]: use [[0, 0, 0.5], [0, 0, -2]]"),
        ('motion.points_mm=[[0,0,"a"],[1,1,1]]', f"{POINTS} [[0, 0, a], [1, 1, 1]]: use [[0, 0, 0.5], [0, 0, -2]]"),
        (
            "motion.points_mm=[[1,1,1],[1,1,1]]",
            "motion.points_mm must hold two different points, got only one: add where the tool goes",
        ),
        ("motion.axis=[0,1]", "motion.axis must be three finite numbers [x, y, z], got [0, 1]: use [0, 0, 1]"),
        ("motion.axis=[0,0,0]", "motion.axis must have a length, got (0, 0, 0): use [0, 0, 1]"),
        (
            "anatomy.size_mm=[0,1,1]",
            "anatomy.size_mm must be three finite numbers [x, y, z], each at least 0.1 "
            "and at most "
            "500, got [0, 1, 1]: use [20, 12, 8]",
        ),
        ("anatomy.normal=5", "anatomy.normal must be left out for a procedural block, got 5: set anatomy.file, or remove it"),
        (
            "tool.spin_rpm=0.5",
            "tool.spin_rpm must be at least 1 in size, or 0 for a tool that only touches, got 0.5: use 500",
        ),
        ("name=A b", 'name must be lower-case letters, digits, - and _, got A b: use "glenoid-2"'),
        ("description=5", "description must be text, got 5: put it in quotes"),
        (
            "tool.diameter_mm=0.15",
            "voxels.spacing_mm must be at most a quarter of tool.diameter_mm (0.15), got 0.05: use 0.0075",
        ),
        (
            "tool.peg_diameter_mm=2",
            "tool.peg_diameter_mm must be left out for a ball-burr, got 2: set tool.kind = hemispherical-reamer, or remove it",
        ),
        ("spacing", "--set must be key=value, got spacing: use for example voxels.spacing_mm=0.2"),
        ("=1", "--set must be key=value, got =1: use for example voxels.spacing_mm=0.2"),
        (
            "perception=all",
            "device must be given for perception = all: set device = touch, or remove it",
        ),
    ],
)
def test_a_bad_entry_is_refused_in_one_sentence(refused, here, override, sentence):
    assert refused("run", "milling", "--set", override) == sentence
    assert not (here / "runs").exists()


def test_a_motion_without_end_is_refused(refused, here):
    path = here / "slow.toml"
    path.write_text(scene_text("milling").replace("duration_s = 9.0\n", ""))
    slow = ("--set", "motion.feed_mm_s=1e-5", "--set", "motion.points_mm=[[0,0,0.1],[0,0,-3]]")
    assert refused("run", path, *COARSE, *slow) == (
        "duration_s must be given for a motion of more than 3600 s, got nothing for one of 310000 s: give it, or a "
        "greater feed"
    )


@pytest.mark.parametrize(
    ("points", "sentence"),
    [
        (
            "[[100,0,-1],[110,0,-1]]",
            "motion must bring the tool to the bone, got one that with the tool and a margin "
            "reaches from (94, -5.995, -4) to (116, 5.998, 8) mm: move it to the bone between (-10, -6, -6) and "
            "(10, 6, 0) mm",
        ),
        (
            "[[-2,0,1],[2,0,1]]",
            "motion must bring the tool to the bone, got a tool that never touches it: move it to "
            "the bone between (-9.6, -6, -3.2) and (9.6, 6, 0) mm",
        ),
    ],
    ids=["beside", "above"],
)
def test_a_tool_that_never_touches_is_refused(refused, here, points, sentence):
    assert refused("run", "milling", *COARSE, "--set", f"motion.points_mm={points}") == sentence
    assert not (here / "runs").exists()


def test_voxels_that_do_not_fit_the_memory_are_refused_with_what_would_fit(refused, command, here, monkeypatch):
    monkeypatch.setattr("psutil.virtual_memory", lambda: SimpleNamespace(available=1e9))
    assert refused("run", "milling", "--set", "voxels.spacing_mm=0.02", "--no-pictures") == (
        "voxels.spacing_mm must leave the bone within the free memory of 1.0 GB, got 0.02 which needs 2.0 GB: use 0.03"
    )
    monkeypatch.setattr("psutil.virtual_memory", lambda: SimpleNamespace(available=2e6))
    fits = refused("run", "milling", "--set", "voxels.spacing_mm=0.1", "--no-pictures").rsplit(" ", 1)[1]
    code, _, error = command(
        "run", "milling", "--set", f"voxels.spacing_mm={fits}", "--no-pictures", "--duration-s", 0.01
    )
    assert (code, error) == (0, "")


def test_a_peg_that_fits_neither_tool_nor_hole_is_refused(refused):
    loose = refused("run", "glenoid", "--set", "tool.peg_diameter_mm=12")
    wide = refused("run", "glenoid", "--set", "tool.peg_diameter_mm=12", "--set", "tool.diameter_mm=10")
    assert wide.startswith("tool.peg_diameter_mm must be below tool.diameter_mm (10), got 12")
    assert loose.startswith("tool.peg_diameter_mm must fit the guide hole (")
    assert "widen or deepen it by anatomy.guide_hole_diameter_mm and anatomy.guide_hole_depth_mm" in loose
