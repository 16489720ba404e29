"""Measures and refusals of a cut.

They concern structures to keep clear of, element size, and limits of the cutting law.
"""

import warnings

import numpy as np
import pytest
import pyvista
import trimesh
from scipy.spatial.transform import Rotation

import tissue
from tissue.simulation.builders.cutting import element_spacing_m

BURR = tissue.cutters.ball_burr(diameter_mm=3, flutes=6, spin_rpm=20_000)
NERVE_MM = 0.3
"""Radius of a nerve along x, its axis 2 mm under the block's face."""
TIPS, TIMES = tissue.feed_along([[-2, 0.4, 1], [-2, 0.4, -2.6], [1, 0.4, -0.2]], feed_mm_s=40)
EXACT_MM = np.hypot(TIPS[:, 1], TIPS[:, 2] + 1.5 + 2.0) - 1.5 - NERVE_MM
"""Distance of a ball from a cylinder at each pose."""


def nerve():
    """Facets touch the cylinder from outside."""
    made = trimesh.creation.cylinder(radius=NERVE_MM / np.cos(np.pi / 96), height=40.0, sections=96)
    made.apply_transform(trimesh.transformations.rotation_matrix(0.5 * np.pi, [0, 1, 0]))
    made.apply_translation([0.0, 0.0, -2.0])
    return made


def tiny_surface():
    """A surface that is no structure at a millimetre a unit."""
    return pyvista.Sphere(radius=1e-3)


class PathOfOther:
    """Path that is neither text nor a `pathlib.Path`."""

    def __init__(self, path):
        self.path = path

    def __fspath__(self):
        return str(self.path)


def require_measured(distance_mm, events):
    assert (distance_mm <= EXACT_MM + 1e-5).all() and (distance_mm >= EXACT_MM - 0.01).all()
    first, last = events
    begins, ends = TIMES[distance_mm < 0.0][0], TIMES[distance_mm < 0.0][-1]
    assert EXACT_MM.min() < -0.3 < 0.2 < EXACT_MM.max()
    assert first == (pytest.approx(begins), "breached nerve, which is to be kept clear of")
    assert last[0] == pytest.approx(ends, abs=2e-3) and last[1].startswith(
        f"left nerve: {-distance_mm.min():.3f} mm deep"
    )


def test_a_cut_measures_its_distance_from_structures(tmp_path):
    nerve().export(tmp_path / "nerve.stl")
    bone = tissue.Bone.block((12, 8, 6), spacing_mm=0.5)
    cut = bone.cut(BURR, TIPS, TIMES, keep_clear={"nerve": PathOfOther(tmp_path / "nerve.stl")})
    require_measured(cut.distance_mm("nerve"), cut.events)
    assert "distance_nerve_mm" in cut.to_pandas()
    plain = bone.uncut().cut(BURR, TIPS, TIMES)
    assert np.array_equal(plain.force_N, cut.force_N) and plain.events == []


def test_a_turned_and_moved_cut_measures_the_same():
    """A turned and moved cut has equal measures.

    Its frame is 9 m away, and its poses are 10 ms apart with times of their own, for a surface from
    pyvista.
    """
    turn, shift = Rotation.random(random_state=4), np.array([9000.0, -300.0, 40.0])
    vertices = turn.apply(np.asarray(nerve().vertices)) + shift
    surface = pyvista.PolyData.from_regular_faces(vertices, np.asarray(nerve().faces))
    quaternions = np.tile(turn.as_quat(), (len(TIPS), 1))
    poses = np.hstack([turn.apply(TIPS) + shift, quaternions])[::10]
    bone = tissue.Bone.from_array(
        np.full((4, 4, 4), 1800.0), spacing_mm=0.5, origin_mm=shift + 50.0
    )
    cut = bone.cut(BURR, poses, 7.0 + TIMES[::10], keep_clear={"nerve": surface})
    found, exact = cut.distance_mm("nerve"), EXACT_MM[::10]
    assert (found <= exact + 1e-5).all() and (found >= exact - 0.01).all()
    assert cut.events[0][0] == pytest.approx(7.0 + TIMES[::10][found < 0.0][0])


def test_elements_follow_depth_and_tolerance():
    fine, coarse = (
        element_spacing_m(BURR, depth_m=1e-4, tolerance=share) for share in (0.005, 0.02)
    )
    assert coarse / fine == pytest.approx(4.0 ** (2.0 / 3.0))
    bone = tissue.Bone.block((8, 6, 3), spacing_mm=0.2)
    bone.cut(BURR, [[0, 0, 1], [0, 0, 0.9]], [0, 1], depth_mm=0.5, tolerance=0.05)
    assert len(bone.voxel_bone._last.shell.areas_m2) < 2000
    for options in ({"depth_mm": 0}, {"tolerance": 1.0}):
        with pytest.raises(tissue.InputError, match=f"{next(iter(options))} must be in"):
            bone.cut(BURR, [[0, 0, 1], [0, 0, 0.9]], [0, 1], **options)


def slot(spin_rpm, feed_mm_s, **options):
    burr = tissue.cutters.ball_burr(diameter_mm=3, flutes=6, spin_rpm=spin_rpm)
    bone = tissue.Bone.block((8, 6, 3), spacing_mm=0.25)
    return bone.cut(burr, *tissue.feed_along([[-6, 0, -0.1], [0, 0, -0.1]], feed_mm_s), **options)


def test_chips_beyond_the_law_are_warned_of_and_absurd_ones_refused():
    """Chips beyond the law cause a warning and absurd ones a refusal.

    Feed per tooth by hand: 20 mm/s over 6 x 1000 / 60 teeth a second is 0.2 mm, at 10 rpm 5 mm/s is
    5 mm.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        within = slot(1000, 9.9)
    assert within.notes == {} and within.events == []
    with pytest.warns(UserWarning, match="is 0.2 mm per tooth") as warned:
        beyond = slot(1000, 20)
    assert warned[0].filename == __file__
    assert (
        "0.2 mm per tooth" in beyond.notes["chips"] and beyond.events[0][1] == beyond.notes["chips"]
    )
    for spin, feed, chip in ((10, 5, "5 mm"), (1, 500, r"5e\+03 mm")):
        with pytest.raises(
            tissue.InputError, match=f"tool's radius of 1.5 mm, got a chip of {chip}"
        ):
            slot(spin, feed)


@pytest.mark.slow
def test_a_peg_in_solid_bone_is_warned_of_and_one_in_its_hole_is_not():
    tool = tissue.cutters.flat_reamer(
        diameter_mm=8, length_mm=3, peg_diameter_mm=3, peg_length_mm=4, flutes=4, spin_rpm=500
    )
    path = tissue.feed_along([[0, 0, 4.5], [0, 0, 1]], feed_mm_s=2)
    solid = tissue.Bone.block((12, 12, 6), spacing_mm=0.25)
    with pytest.warns(UserWarning, match="such as its peg, is pushed into bone"):
        cut = solid.cut(tool, *path)
    assert "smooth surface" in cut.notes and cut.force_magnitude_N.max() == 0.0
    drilled = solid.uncut()
    drill = tissue.cutters.cylinder(diameter_mm=3, length_mm=12, flutes=2, spin_rpm=1000)
    drilled.cut(drill, *tissue.feed_along([[0, 0, 1], [0, 0, -5]], feed_mm_s=1))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert drilled.cut(tool, *path).notes == {}


def test_more_elements_than_memory_holds_are_refused():
    bone = tissue.Bone.block((4, 4, 2), spacing_mm=0.5)
    with pytest.raises(
        tissue.InputError, match=r"depth_mm = 0\.001 with tolerance = 0\.001 needs .* elements"
    ):
        bone.cut(BURR, [[0, 0, 1.0], [0, 0, 0.9]], [0.0, 0.001], depth_mm=0.001, tolerance=0.001)
