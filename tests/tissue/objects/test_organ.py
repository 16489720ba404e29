"""A soft organ in the hand: what it is made from, what a press gives, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
import pyvista

import tissue
from meshes.base.errors import InputError
from meshes.tets.structured import box
from meshes.tets.tetrahedra import TetMesh
from tissue.fitting.fit_files import write_fitted
from tissue.materials.constants import Constant
from tissue.objects.press import _resolution
from tissue.simulation.builders.organ import material_of

STIFF = {"modulus_kPa": 8.0, "poisson_ratio": 0.45}
BALL = tissue.ball(diameter_mm=12)


def cube(cells=(6, 6, 4), size_mm=(48.0, 48.0, 24.0)):
    """Points [mm] and cells of a block with the middle of its top face at the origin."""
    mesh = box(tuple(1e-3 * side for side in size_mm), cells)
    return 1e3 * mesh.nodes_m - [0.5 * size_mm[0], 0.5 * size_mm[1], size_mm[2]], mesh.cells


def grid_of(points, cells, **arrays):
    grid = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: cells}, points)
    for name, values in arrays.items():
        grid.cell_data[name] = values
    return grid


@pytest.fixture(scope="module")
def organ():
    return tissue.Organ.from_tetrahedra(cube(), **STIFF)


@pytest.fixture(scope="module")
def press(organ):
    return organ.refined(edge_mm=3, near_mm=(0, 0, 0)).press(BALL, depth_mm=2.0, at_mm=(0, 0, 0))


def test_a_press_gives_force_over_depth_and_the_organ_under_it(press):
    assert press.force_N[2] == press.forces_N[-1, 2] > 0.05
    assert (np.diff(press.depth_mm) > 0.0).all() and press.depth_mm[-1] == pytest.approx(2.0)
    assert not press.forces_N[0].any() and press.forces_N[1:, 2].min() >= 0.0
    assert press.stiffness_N_mm > press.force_magnitude_N / 2.0  # stiffens as a ball sinks in
    mesh = press.mesh
    under = np.linalg.norm(mesh.points, axis=1).argmin()
    assert mesh["displacement_mm"][under, 2] == pytest.approx(-2.0, abs=0.2)
    assert mesh["von_mises_kPa"].max() > 0.1
    np.testing.assert_allclose(mesh["reaction_N"].sum(axis=0), press.force_N, atol=1e-4)


def test_parts_are_known_by_name_by_number_and_by_array():
    points, cells = cube()
    deep = points[cells].mean(axis=1)[:, 2] < -12.0
    labels, names = np.where(deep, 7, 3), np.where(deep, "cyst", "kidney")
    soft = tissue.Organ.from_tetrahedra((points, cells), **STIFF)
    organs = [
        tissue.Organ.from_tetrahedra(grid_of(points, cells, part=labels), parts={7: 80}, **STIFF),
        tissue.Organ.from_tetrahedra(
            grid_of(points, cells, region=labels),
            part_names={7: "cyst"},
            parts={"cyst": 80},
            **STIFF,
        ),
        tissue.Organ.from_tetrahedra(
            grid_of(points, cells, part=names), parts={"cyst": 80}, **STIFF
        ),
    ]
    assert organs[1].moduli_kPa == {"part 3": 8.0, "cyst": 80.0}
    forces = [
        each.press(BALL, depth_mm=2, at_mm=(0, 0, 0)).force_magnitude_N for each in (soft, *organs)
    ]
    assert forces[1] > 1.05 * forces[0]
    assert forces[1:] == pytest.approx([forces[1]] * 3, rel=1e-9)
    with pytest.raises(
        InputError,
        match=r"parts must name parts of the mesh, got 'tumour'\. Use names of its parts: cyst, "
        "kidney",
    ):
        tissue.Organ.from_tetrahedra(
            grid_of(points, cells, part=names), parts={"tumour": 80}, **STIFF
        )


TURNS = {
    "turned": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    "upside down": np.diag([1.0, -1.0, -1.0]),
    "mirrored": np.diag([-1.0, 1.0, 1.0]),
}


def off_middle(
    place=(6.0, 4.0, 0.0),
    *,
    turn=None,
    moved_mm=(0.0, 0.0, 0.0),
    unit_mm=1.0,
    permuted=False,
    mesh=None,
):
    """Return the force of a slanted press on the block at a place off its middle, and the press.

    The force is in the block's frame.
    """
    points, cells = cube() if mesh is None else mesh
    bottom = np.flatnonzero(points[:, 2] < -23.9)
    turn = np.eye(3) if turn is None else turn
    world = points @ turn.T + moved_mm
    if permuted:
        order = np.random.default_rng(5).permutation(len(points))
        place_of = np.argsort(order)
        world, bottom, cells = world[order], place_of[bottom], place_of[cells][::-1, [1, 2, 0, 3]]
    organ = tissue.Organ.from_tetrahedra(
        (world / unit_mm, cells), scale_mm=None if unit_mm == 1.0 else unit_mm, held=bottom, **STIFF
    )
    press = organ.press(
        BALL, depth_mm=2.0, at_mm=turn @ place + moved_mm, along=turn @ np.array([0.3, 0.2, -1.0])
    )
    return press.force_N @ turn, press


def test_a_press_without_notes_prints_no_empty_part(press):
    assert repr(replace(press, notes={})).endswith(" mm2)")


@pytest.fixture(scope="module")
def straight():
    return off_middle()[0]


@pytest.mark.parametrize(
    "changes",
    [
        *({"turn": turn} for turn in TURNS.values()),
        {"moved_mm": (500.0, -300.0, 80.0)},
        {"unit_mm": 1000.0},
        {"permuted": True},
    ],
    ids=[*TURNS, "moved", "metres", "permuted"],
)
def test_a_press_does_not_know_how_its_mesh_lies(straight, changes):
    """A press does not depend on the layout of its mesh.

    1e-3 is the contact's tolerance: with nodes in another order the sweeps take another order, too.
    """
    force, press = off_middle(**changes)
    np.testing.assert_allclose(force, straight, atol=2e-3 * np.linalg.norm(straight))
    assert press.force_magnitude_N == pytest.approx(np.linalg.norm(force))


def test_columns_and_what_is_read_off_the_factor_agree():
    organ = tissue.Organ.from_tetrahedra(cube(), **STIFF)
    places = [(0, 0, 0), (10, -6, 0)]
    first = [organ.press(BALL, depth_mm=1.5, at_mm=at).force_N for at in places]
    organ = tissue.Organ.from_tetrahedra(cube(), **STIFF)
    second = [organ.press(BALL, depth_mm=1.5, at_mm=at).force_N for at in places[::-1]]
    np.testing.assert_allclose(first, second[::-1], rtol=1e-8, atol=1e-10)


def test_steps_do_not_matter(organ, monkeypatch):
    few = organ.press(BALL, depth_mm=2, at_mm=(3, 2, 0)).force_magnitude_N
    monkeypatch.setattr("tissue.models.organ.press.STEPS", 400)
    assert organ.press(BALL, depth_mm=2, at_mm=(3, 2, 0)).force_magnitude_N == pytest.approx(
        few, rel=2e-3
    )


def test_what_holds_it_may_be_stated_in_any_form():
    points, cells = cube()
    forms = (
        {"held": "bottom"},
        {"held": "-z"},
        {"held_below_mm": -24.0},
        {"held": points[:, 2] < -23.9},
    )
    forms += ({"held": np.flatnonzero(points[:, 2] < -23.9)},)
    organs = [tissue.Organ.from_tetrahedra((points, cells), **STIFF, **form) for form in forms]
    count = [int(each.mesh["held"].sum()) for each in organs]
    assert count == [49] * len(forms)
    finer = [int(each.refined(edge_mm=7).mesh["held"].sum()) for each in organs]
    assert finer == [finer[0]] * len(forms) and finer[0] > 49


@pytest.mark.slow
def test_a_surface_is_filled_and_its_inclusion_is_a_part(tmp_path):
    outer, inner = pyvista.Sphere(radius=20), pyvista.Sphere(radius=7, center=(0, 0, 9))
    inner.save(tmp_path / "cyst.stl")
    made = {"edge_mm": 8, **STIFF}
    plain = tissue.Organ.from_surface(outer, **made)
    both = tissue.Organ.from_surface(
        outer.triangulate(), inclusions={"cyst": tmp_path / "cyst.stl"}, parts={"cyst": 80}, **made
    )
    mesh = both.mesh.compute_cell_sizes()
    volume = mesh["Volume"][mesh["part"] == 1].sum()
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * 7.0**3, rel=0.03)
    assert both.notes["cyst"].startswith("1.42 ml (volume of the mesh: within ")
    soft, stiff = (
        each.press(BALL, depth_mm=2, at_mm=(0, 0, 20)).force_magnitude_N for each in (plain, both)
    )
    assert stiff > 1.05 * soft
    with pytest.raises(
        InputError, match="parts must give a modulus for every inclusion, got none for cyst"
    ):
        tissue.Organ.from_surface(outer, inclusions={"cyst": inner}, **made)


def test_an_organ_that_relaxes_is_held_and_others_are_not(organ):
    soft = tissue.Organ.from_tetrahedra(cube(), relaxation=[(0.4, 0.05)], **STIFF)
    press = soft.press(BALL, depth_mm=2, at_mm=(0, 0, 0), speed_mm_s=500, hold_s=0.3)
    quick = organ.press(BALL, depth_mm=2, at_mm=(0, 0, 0)).force_magnitude_N
    sizes = np.linalg.norm(press.forces_N, axis=1)
    assert sizes.max() == pytest.approx(quick, rel=0.05)
    assert sizes[-1] == pytest.approx(0.6 * quick, rel=0.02)
    assert press.time_s[-1] == pytest.approx(0.3 + 2 / 500, rel=0.02)
    with pytest.raises(
        InputError, match="hold_s must be left out for an organ that does not relax"
    ):
        organ.press(BALL, depth_mm=2, at_mm=(0, 0, 0), hold_s=1)


def test_capsule_weight_and_order_have_their_effect(organ):
    plain = organ.press(BALL, depth_mm=2, at_mm=(0, 0, 0)).force_magnitude_N
    options = ({"capsule": (50, 8000)}, {"order": 1}, {"density_kg_m3": 1060})
    forces = [
        tissue.Organ.from_tetrahedra(cube(), **STIFF, **option)
        .press(BALL, depth_mm=2, at_mm=(0, 0, 0))
        .force_magnitude_N
        for option in options
    ]
    assert (
        forces[0] > 1.02 * plain
        and forces[1] > 1.1 * plain
        and forces[2] == pytest.approx(plain, rel=0.1)
    )


def test_a_tool_from_a_file_presses_as_its_shape_does(organ, tmp_path):
    """A capsule's round end, by a few hundred points, within 5 % of a ball of its radius."""
    finger = pyvista.Capsule(
        center=(0, 0, 21), direction=(0, 0, 1), radius=6, cylinder_length=30, resolution=60
    )
    finger.triangulate().clean().save(tmp_path / "finger.stl")
    tool = tissue.probe_from_file(tmp_path / "finger.stl")
    fine = organ.refined(edge_mm=3, near_mm=(0, 0, 0))
    ball, shell = (
        fine.press(each, depth_mm=2, at_mm=(0, 0, 0)).force_magnitude_N for each in (BALL, tool)
    )
    assert shell == pytest.approx(ball, rel=0.05)
    with pytest.raises(InputError, match=r"file must exist, got nowhere\.stl"):
        tissue.probe_from_file("nowhere.stl")


def changed(**changes):
    return lambda: tissue.Organ.from_tetrahedra(cube(), **(STIFF | changes))


def pressing(**changes):
    press = {"tool": BALL, "depth_mm": 1.0, "at_mm": (0, 0, 0)} | changes
    return lambda: tissue.Organ.from_tetrahedra(cube(), **STIFF).press(**press)


@pytest.mark.parametrize(
    ("act", "sentence"),
    [
        (
            changed(modulus_kPa=-1),
            "modulus_kPa must be positive and finite, got -1. Liver has about 5",
        ),
        (changed(poisson_ratio=0.5), "poisson_ratio must be in [-0.999, 0.4999], got 0.5"),
        (
            changed(parts={"cyst": 40}),
            "parts must name parts of the mesh, got 'cyst'. Use names of its parts: body",
        ),
        (
            changed(held="left"),
            "held must be one of bottom, top, -x, +x, -y, +y, -z, +z, body, or an array of points, "
            "got 'left'",
        ),
        (changed(held=[]), "held must"),
        (
            changed(held=[4000]),
            "held must be a side, a part, a mask of the 245 points or indices of points, got an array",
        ),
        (changed(held=[0]), "supports must leave no rigid motion free"),
        (changed(held_below_mm=-50), "held_below_mm must touch the body"),
        (changed(relaxation=[(0.4, -1)]), "relaxation"),
        (changed(capsule=(50, 0)), "capsule must be positive"),
        (
            pressing(at_mm=(0, 0, 30)),
            "at_mm must lie on the surface, got (0, 0, 30). Use the nearest point of the surface",
        ),
        (pressing(at_mm=(0, 0)), "at_mm must be three finite numbers"),
        (
            pressing(along=(0, 0, 1)),
            "along must point into the organ, got (0, 0, 1). Use (0, 0, -1)",
        ),
        (pressing(depth_mm=0), "depth_mm must be positive"),
        (pressing(at_mm=(0, 0, -24)), "at_mm must bring the tool to tissue that can move"),
        (lambda: tissue.ball(diameter_mm=0), "diameter_mm must be in [0.5, 100], got 0"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(act, sentence):
    with pytest.raises(InputError) as refused:
        made = act()
        made.press(BALL, depth_mm=1, at_mm=(0, 0, 0))
    assert str(refused.value).startswith(sentence) and "\n" not in str(refused.value)


def test_meshio_like_blocks_and_quadratic_cells_are_taken():
    from types import SimpleNamespace

    points, cells = cube()
    mesh = SimpleNamespace(
        points=points,
        cells=[
            SimpleNamespace(type="triangle", data=cells[:5, :3]),
            SimpleNamespace(type="tetra", data=cells),
        ],
        cell_data={"gmsh:physical": [np.ones(5, int), np.where(np.arange(len(cells)) < 9, 2, 1)]},
        field_data={"kidney": np.array([1, 3]), "cyst": np.array([2, 3]), "skin": np.array([1, 2])},
    )
    organ = tissue.Organ.from_tetrahedra(mesh, parts={"cyst": 30}, **STIFF)
    assert organ.moduli_kPa == {"kidney": 8.0, "cyst": 30.0}


def test_refined_organ_has_a_note_with_its_number_of_tetrahedra(organ):
    fine = organ.refined(edge_mm=7, near_mm=(0, 0, 0))
    assert fine.notes["refined mesh"].startswith(f"{fine.mesh.n_cells} tetrahedra ")
    assert "refined mesh" not in organ.notes and fine.mesh.n_cells > organ.mesh.n_cells


@pytest.mark.parametrize(("size_mm", "is_noted"), [(8.0, True), (48.0, False), (400.0, True)])
def test_implausible_volume_is_noted_unless_the_unit_is_given(size_mm, is_noted):
    mesh = cube((2, 2, 2), (size_mm, size_mm, size_mm))
    for scale_mm, expected in ((None, is_noted), (1.0, False)):
        notes = tissue.Organ.from_tetrahedra(mesh, scale_mm=scale_mm, **STIFF).notes
        assert ("give scale_mm" in notes.get("unit", "")) is expected


@pytest.mark.parametrize(("modulus_kPa", "is_noted"), [(6.0, False), (6000.0, True)])
def test_modulus_far_from_that_of_liver_is_noted(modulus_kPa, is_noted):
    mesh = cube((2, 2, 2), (48.0, 48.0, 48.0))
    notes = tissue.Organ.from_tetrahedra(mesh, **STIFF | {"modulus_kPa": modulus_kPa}).notes
    assert ("is modulus_kPa = 6000 in kPa?" in notes.get("modulus", "")) is is_noted


@pytest.mark.parametrize(
    ("edge_mm", "order", "key"),
    [
        (1.7, 1, None),
        (2.0, 1, "contact area"),
        (2.9, 1, "contact area"),
        (3.5, 2, None),
        (3.7, 2, "contact area"),
        (4.5, 1, "mesh"),
        (4.5, 2, "mesh"),
    ],
)
def test_edges_that_are_too_long_for_the_area_or_the_force_are_noted(edge_mm, order, key):
    leg = 1e-3 * edge_mm / np.sqrt(2.0)
    nodes = leg * np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    mesh = TetMesh(nodes, np.array([[0, 1, 2, 3]]))
    notes = _resolution(mesh, BALL.shape, nodes[:3].mean(axis=0), order=order)
    assert list(notes) == ([] if key is None else [key])


def test_loop_of_an_organ_names_it(organ):
    loop = tissue.Loop(organ, BALL, start_mm=(0, 0, 1))
    assert repr(loop).startswith("Loop(Organ, 0 ticks")


def test_pictures_are_drawn(organ, press, tmp_path, monkeypatch, capfd):
    monkeypatch.delenv("DISPLAY", raising=False)
    shown = {"off_screen": True, "window_size": (300, 200)}
    organ.plot(screenshot=tmp_path / "organ.png", **shown)
    press.plot(screenshot=tmp_path / "press.png", scalars="von_mises_kPa", **shown)
    assert "X server" not in capfd.readouterr().err
    for name in ("organ", "press"):
        picture = pyvista.read(tmp_path / f"{name}.png")
        assert len(np.unique(np.asarray(picture.active_scalars), axis=0)) > 50


def test_a_press_whose_force_falls_with_depth_is_refused():
    """A press whose force falls with depth is refused.

    Deeper than it is wide the ball passes through the part that the linear law moves: no figure is
    better than a wrong one.
    """
    organ = tissue.Organ.block((40, 40, 20), modulus_kPa=8, poisson_ratio=0.45, edge_mm=4, order=1)
    with pytest.raises(
        InputError,
        match=r"depth_mm must be a depth up to which the force increases, got 14, .*Use a smaller depth",
    ):
        organ.press(tissue.ball(diameter_mm=12), depth_mm=14, at_mm=(0, 0, 0))


def test_a_liver_with_a_file_of_constants_is_that_of_a_scene_with_it(tmp_path):
    file = tmp_path / "fitted.toml"
    values = {
        "soft.liver.modulus_kPa": 7.0,
        "soft.liver.poisson_ratio": 0.46,
        "soft.kidney.modulus_kPa": 9.0,
    }
    entries = {name: Constant(value, value, value, "a test", "L") for name, value in values.items()}
    write_fitted(file, entries, np.eye(3))
    organ = tissue.Organ.liver(edge_mm=40, materials=file)
    scene = tissue.load_scene(
        "liver-press", {"materials": str(file), "organ.material": "liver", "organ.law": "linear"}
    )
    mesh, material = organ._made.mesh, organ._made.material
    wanted, _ = material_of(scene.anatomy, scene.organ, scene.constants)
    assert np.array_equal(material.elasticity(mesh), wanted.elasticity(mesh))
    assert organ.moduli_kPa == {"body": 7.0} and material.poisson_ratio == 0.46
    assert organ.notes["materials"].endswith("Not used in this organ: soft.kidney.modulus_kPa")
