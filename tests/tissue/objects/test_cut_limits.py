"""Measures and refusals of a cut.

They concern structures to keep clear of, element size, and limits of the cutting law.
"""

import inspect
import warnings

import numpy as np
import pytest
import pyvista
import trimesh
from scipy.spatial.transform import Rotation

import tissue
from tissue.simulation.builders.bone import element_spacing_m

BURR = tissue.cutters.ball_burr(diameter_mm=3, flutes=6, spin_rpm=20_000)
NERVE_MM = 0.3
"""Radius of a nerve along x, its axis 2 mm under the block's face."""
TIPS, TIMES = tissue.feed_along([[-2, 0.4, 1], [-2, 0.4, -2.6], [1, 0.4, -0.2]], feed_mm_s=20)
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

    Its frame is 9 m away, and its poses are 20 ms apart with times of their own, for a surface from
    pyvista.
    """
    turn, shift = Rotation.random(random_state=4), np.array([9000.0, -300.0, 40.0])
    vertices = turn.apply(np.asarray(nerve().vertices)) + shift
    surface = pyvista.PolyData.from_regular_faces(vertices, np.asarray(nerve().faces))
    quaternions = np.tile(turn.as_quat(), (len(TIPS), 1))
    poses = np.hstack([turn.apply(TIPS) + shift, quaternions])[::20]
    bone = tissue.Bone.from_array(
        np.full((4, 4, 4), 1800.0), spacing_mm=0.5, origin_mm=shift + 50.0
    )
    cut = bone.cut(BURR, poses, 7.0 + TIMES[::20], keep_clear={"nerve": surface})
    found, exact = cut.distance_mm("nerve"), EXACT_MM[::20]
    assert (found <= exact + 1e-5).all() and (found >= exact - 0.01).all()
    assert cut.events[0][0] == pytest.approx(7.0 + TIMES[::20][found < 0.0][0])


@pytest.mark.slow
def test_a_loop_measures_its_distance_from_structures(tmp_path):
    """The nerve lies 4 mm above the bone, where the tool follows the device freely."""

    class Moves:
        def read(self, time_s):
            at = np.array([np.interp(time_s, TIMES, TIPS[:, k]) for k in range(3)])
            return tissue.Sample(time_s, tuple(1e-3 * (at - TIPS[0])))

        def command(self, force_N, torque_Nm):
            pass

    nerve().apply_translation([0.0, 0.0, 6.0]).export(tmp_path / "nerve.stl")
    bone = tissue.Bone.block((12, 8, 6), spacing_mm=0.5)
    start = TIPS[0] + [0.0, 0.0, 6.0]
    loop = tissue.Loop(
        bone, BURR, device=Moves(), start_mm=start, keep_clear={"nerve": tmp_path / "nerve.stl"}
    )
    loop.run(float(TIMES[-1]))
    tips = np.column_stack([loop.trace[f"tool_{c}_mm"] for c in "xyz"])
    exact = np.hypot(tips[:, 1], tips[:, 2] - 2.5) - 1.5 - NERVE_MM
    found = loop.trace["distance_nerve_mm"]
    assert exact.min() < -0.1
    assert (found <= exact + 1e-5).all() and (found >= exact - 0.01).all()
    assert loop.events[0][1] == "breached nerve, which is to be kept clear of"


@pytest.mark.parametrize(
    ("keep_clear", "words"),
    [
        ({"Nerve 1": "a.stl"}, "keep_clear must have names of small letters"),
        ({"nerve": "none.stl"}, r"keep_clear\[nerve\] must exist"),
        ({"nerve": 3}, r"keep_clear\[nerve\] must be a closed surface .*, got int"),
        ("nerve.stl", "keep_clear must be a mapping"),
        ({"nerve": tiny_surface()}, r"^keep_clear\[nerve\] must make the longest side"),
    ],
)
def test_what_cannot_be_kept_clear_of_is_refused(keep_clear, words):
    with pytest.raises(tissue.InputError, match=words):
        tissue.Bone.block((12, 8, 6), spacing_mm=0.5).cut(BURR, TIPS, TIMES, keep_clear=keep_clear)


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
    with pytest.warns(UserWarning, match="is 0.2 mm per tooth"):
        beyond = slot(1000, 20)
    assert (
        "0.2 mm per tooth" in beyond.notes["chips"] and beyond.events[0][1] == beyond.notes["chips"]
    )
    for spin, feed, chip in ((10, 5, "5 mm"), (1, 500, r"5e\+03 mm")):
        with pytest.raises(tissue.InputError, match=f"tool's radius of 1.5 mm, got {chip}"):
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


@pytest.mark.parametrize(
    "cutting",
    [
        {"tangential_chip_N_mm2": -1.0},
        {"radial_edge_N_mm": np.nan},
        [1.0],
        {"no": 1},
        {"radial_edge_N_mm": "4"},
    ],
)
def test_impossible_coefficients_are_refused(cutting):
    with pytest.raises(tissue.InputError, match="cutting"):
        tissue.Bone.block((4, 4, 2), spacing_mm=0.5, cutting=cutting)


def test_more_elements_than_memory_holds_are_refused():
    bone = tissue.Bone.block((4, 4, 2), spacing_mm=0.5)
    with pytest.raises(
        tissue.InputError, match=r"depth_mm = 0\.001 with tolerance = 0\.001 needs .* elements"
    ):
        bone.cut(BURR, [[0, 0, 1.0], [0, 0, 0.9]], [0.0, 0.001], depth_mm=0.001, tolerance=0.001)


def test_bone_that_fills_an_array_to_its_edge_is_cut_like_a_block():
    """The surface lies on the outer faces of the voxels, in the array as in the block."""
    axis = np.array([0.0, 0.8, 0.6])
    tips, times = tissue.feed_along(np.array([[-3, 0, 2.9], [0.3, 0, 2.9]]) - 3.0 * axis, 20)
    burr = tissue.cutters.ball_burr(diameter_mm=6, flutes=6, spin_rpm=10_000)
    full = tissue.Bone.from_array(
        np.full((80, 40, 20), 1800.0), spacing_mm=0.1, origin_mm=(-4, -2, -2)
    )
    block = tissue.Bone.block((8, 4, 2), spacing_mm=0.1)
    forces = [
        each.cut(burr, tips, times, axis=axis).force_N[-20:].mean(axis=0) for each in (full, block)
    ]
    assert np.linalg.norm(forces[0] - forces[1]) < 0.01 * np.linalg.norm(forces[1])


def public_callables():
    """All functions and methods that `tissue` offers, by name."""
    for name in tissue.__all__:
        value = getattr(tissue, name)
        members = {}
        if inspect.ismodule(value):
            members = {each: getattr(value, each) for each in getattr(value, "__all__", ())}
        elif inspect.isclass(value):
            members = {
                each: getattr(value, each) for each in dir(value) if not each.startswith("_")
            }
        for each, member in ({"": value} | members).items():
            if callable(member) and getattr(member, "__module__", "").split(".")[0] in (
                "tissue",
                "meshes",
            ):
                yield f"{name}.{each}".rstrip("."), member


def test_no_public_function_swallows_an_unknown_keyword(tmp_path):
    """Listed arguments refuse others by themselves; the few that take any are called with one."""
    takes_any = {
        name
        for name, function in public_callables()
        if any(
            each.kind == each.VAR_KEYWORD
            for each in inspect.signature(function).parameters.values()
        )
    }
    array, surface = np.full((4, 4, 4), 1800.0), trimesh.creation.icosphere(radius=5.0)
    surface.export(tmp_path / "ball.stl")
    bone = tissue.Bone.from_array(array, spacing_mm=0.5)
    organ = tissue.Organ.block((20, 20, 10), modulus_kPa=5, poisson_ratio=0.45)
    calls = {
        "Bone": lambda **more: tissue.Bone(bone._source, **more),
        "Bone.block": lambda **more: tissue.Bone.block((4, 4, 2), spacing_mm=0.5, **more),
        "Bone.from_array": lambda **more: tissue.Bone.from_array(array, spacing_mm=0.5, **more),
        "Bone.from_file": lambda **more: tissue.Bone.from_file(tmp_path / "ball.stl", **more),
        "Bone.from_image": lambda **more: tissue.Bone.from_image(
            tmp_path / "none.nii", threshold=1, **more
        ),
        "Bone.plot": lambda **more: bone.plot(off_screen=True, **more),
        "Organ.plot": lambda **more: organ.plot(off_screen=True, **more),
        "Press.plot": None,  # of the same plotter as Organ.plot
        "Organ.block": lambda **more: tissue.Organ.block(
            (20, 20, 10), modulus_kPa=5, poisson_ratio=0.45, **more
        ),
        "Organ.from_labels": lambda **more: tissue.Organ.from_labels(
            tmp_path / "none.nrrd", organ="liver", modulus_kPa=5, poisson_ratio=0.45, **more
        ),
        "Organ.from_surface": lambda **more: tissue.Organ.from_surface(
            tmp_path / "ball.stl", modulus_kPa=5, poisson_ratio=0.45, **more
        ),
        "Organ.from_tetrahedra": lambda **more: tissue.Organ.from_tetrahedra(
            tmp_path / "none.vtu", modulus_kPa=5, poisson_ratio=0.45, **more
        ),
        "Loop": lambda **more: tissue.Loop(bone, device=None, **more),
        "Organ.liver": lambda **more: tissue.Organ.liver(edge_mm=20, **more),
        "import_ct": lambda **more: tissue.import_ct(tmp_path / "none.nii", tmp_path, **more),
        "calibration.alike": lambda **more: tissue.calibration.alike(3, **more),
    }
    assert takes_any <= set(calls)
    for name in takes_any - {"Press.plot"}:
        with pytest.raises((TypeError, tissue.InputError), match="densty"):
            calls[name](densty=500)
    with pytest.raises(TypeError, match="did you mean material"):
        tissue.Bone.block(materal="bone")
