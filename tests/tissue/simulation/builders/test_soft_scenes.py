"""Soft organs by their scenes: what a run of them gives, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshes.base.errors import InputError
from meshes.tets.structured import box
from tissue import load_scene, simulate
from tissue.fem.assembly import assemble
from tissue.fem.space import Space
from tissue.materials.scene_constants import Materials
from tissue.scene.organ import Organ
from tissue.simulation.builders.organ import material_of

PRESS = {
    "anatomy.edge_mm": 22.0,
    "organ.material": "liver",
    "organ.law": "linear",
    "organ.interval_ms": 50.0,
    "motion.points_mm": [[0, 0, 1], [0, 0, -6], [3, 0, -6], [3, 0, 1]],
    "motion.feed_mm_s": 40.0,
}
SLAB = {
    "anatomy.edge_mm": 12.0,
    "anatomy.size_mm": [60, 60, 30],
    "anatomy.touch_edge_mm": 6.0,
    "anatomy.nodule_diameter_mm": 0.0,
    "organ.young_end_kPa": None,
    "organ.interval_ms": 50.0,
    "motion.points_mm": [[0, 0, 1], [0, 0, -3]],
    "motion.feed_mm_s": 20.0,
    "duration_s": 0.3,
}


SMALL = {
    "anatomy.size_mm": [24, 24, 12],
    "tool.diameter_mm": 8.0,
    "motion.points_mm": [[0, 0, 1], [0, 0, -1.5], [3, 0, -1.5]],
}
PATHS = ("condensed", "reduced")


def press(**changes):
    return simulate(
        load_scene("liver-press", PRESS | {k.replace("__", "."): v for k, v in changes.items()})
    )


def slab(**changes):
    return simulate(
        load_scene("palpation", SLAB | {k.replace("__", "."): v for k, v in changes.items()})
    )


@pytest.fixture(scope="module")
def pressed():
    return press()


def test_a_pressed_liver_pushes_back_and_lets_go(pressed):
    force, depth = pressed.trace["model_force_z_N"], -pressed.trace["tool_z_mm"]
    assert (force >= 0.0).all() and not force[depth < -0.5].any()
    assert 0.1 < force.max() < 2.0
    deep = np.argmax(depth > 5.9)
    assert force[deep] > 4.0 * force[np.argmax(depth > 1.5)]  # stiffens as a ball sinks in
    assert pressed.trace["contact_points"].max() > 0


def test_frames_hold_the_support_and_carry_the_force(pressed):
    """At every frame the reactions of what is held balance the tool's force, to rounding."""
    series, force = pressed.parts.tissue.fields, pressed.trace.vectors("model_force", "N")
    loaded = 0
    for frame in series.frames:
        on_organ = -force[round(frame.time_s * 1e3)]
        carried = frame.points["reaction_N"].astype(float).sum(axis=0)
        np.testing.assert_allclose(carried, -on_organ, atol=2e-4 * max(np.abs(on_organ).max(), 0.1))
        held = np.linalg.norm(frame.points["reaction_N"], axis=1) > 1e-6
        assert not frame.points["displacement_mm"][held].any()
        loaded += bool(on_organ.any())
    assert loaded > 3
    assert set(series.frames[0].cells) == {
        "von_mises_kPa",
        "principal_stress_kPa",
        "strain_percent",
    }


def test_paths_to_the_compliance_agree():
    """The whole compliance and a basis of all modes have equal forces."""
    forces = [
        slab(
            **SMALL,
            **{"organ.path": path},
            **({"organ.basis_size": 3000} if path == "reduced" else {}),
        ).trace["model_force_z_N"]
        for path in PATHS
    ]
    assert forces[0].max() > 0.01
    for other in forces[1:]:
        np.testing.assert_allclose(other, forces[0], atol=1e-3 * forces[0].max())


def test_a_run_repeats_bit_for_bit():
    first, again = slab(**SMALL), slab(**SMALL)
    assert again.trace.rows.tobytes() == first.trace.rows.tobytes()
    assert first.trace["model_force_z_N"].any()
    last, before = (run.parts.tissue.fields.frames[-1] for run in (again, first))
    for name, values in before.points.items():
        np.testing.assert_array_equal(last.points[name], values)


def test_force_scales_with_the_modulus():
    soft, hard = (
        slab(**SMALL, **{"organ.young_kPa": young}).trace["model_force_z_N"]
        for young in (5.0, 20.0)
    )
    np.testing.assert_allclose(hard, 4.0 * soft, atol=1e-3 * hard.max())


def test_a_viscous_slab_relaxes_to_its_long_term_share():
    """A viscous slab relaxes to its long-term share.

    Held at depth, the force falls from about the elastic one towards g_inf of it (0.432 by the
    cited series).
    """
    elastic, viscous = (
        slab(),
        slab(**{"organ.viscous": True, "duration_s": 1.5, "motion.feed_mm_s": 200.0}),
    )
    force = viscous.trace["model_force_z_N"]
    assert force.max() > 0.75 * elastic.trace["model_force_z_N"].max()
    assert force[-1] == pytest.approx(0.432 * elastic.trace["model_force_z_N"][-1], rel=0.02)


def test_the_force_rises_with_the_ratio_of_fibres():
    """The force rises with the ratio of fibres.

    Fibres lie across the press and along it, softer than the tissue around them and stiffer.
    """

    def largest_N(**fibres):
        return slab(**{"organ.interval_ms": 0.0}, **fibres).trace["model_force_z_N"].max()

    plain = largest_N()
    for direction in ([1, 0, 0], [0, 0, 1]):
        soft, stiff = (
            largest_N(**{"organ.fibre_direction": direction, "organ.fibre_modulus_ratio": ratio})
            for ratio in (0.5, 3.0)
        )
        assert soft < 0.99 * plain and stiff > 1.01 * plain, (soft / plain, stiff / plain)


def test_fibres_are_the_same_in_a_turned_organ():
    """Fibres are the same in a turned organ.

    The stiffness of a mesh that is turned together with its fibres is compared with the stiffness
    turned by hand.
    """
    scene = load_scene("palpation", SLAB)
    mesh, turn = (
        box((0.02, 0.03, 0.01), (2, 2, 1)),
        Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix(),
    )
    fibre = np.array([2.0, 1.0, -1.0])
    stiffness = []
    for nodes, direction in ((mesh.nodes_m, fibre), (mesh.nodes_m @ turn.T, turn @ fibre)):
        organ = Organ(young_kPa=5.0, fibre_direction=tuple(direction), fibre_modulus_ratio=3.0)
        body = replace(mesh, nodes_m=nodes)
        material, _ = material_of(scene.anatomy, organ, scene.constants)
        stiffness.append(assemble(Space(body, 2), material.elasticity(body)).toarray())
    count = len(stiffness[0]) // 3
    turned = np.einsum("ij,ajbk,lk->aibl", turn, stiffness[0].reshape(count, 3, count, 3), turn)
    np.testing.assert_allclose(
        stiffness[1], turned.reshape(3 * count, -1), atol=1e-9 * np.abs(turned).max()
    )


@pytest.mark.parametrize(
    ("ratio", "poisson", "bound"), [(0.25, 0.0, "more than 0.333"), (3.0, -0.5, "less than 1.5")]
)
def test_fibres_that_would_make_tissue_unstable_are_refused(ratio, poisson, bound):
    fibres = {
        "organ.fibre_direction": [1, 0, 0],
        "organ.fibre_modulus_ratio": ratio,
        "organ.poisson_ratio": poisson,
    }
    with pytest.raises(InputError, match=f"organ.fibre_modulus_ratio must be {bound}"):
        slab(**fibres)


def test_a_liver_from_a_file_is_placed_held_and_pressed(anatomy):
    """The file names no unit: it is given. The origin becomes its highest point, and what faces
    down is held.
    """
    changes = {
        "anatomy.file": str(anatomy / "liver" / "liver.v22.msh"),
        "anatomy.touch_edge_mm": 12.0,
    }
    with pytest.raises(
        InputError,
        match=r"anatomy\.edge_mm must be left out for tetrahedra from a file. Set ",
    ):
        press(**changes, **{"anatomy.scale_mm": 34.3})
    changes["anatomy.edge_mm"] = None
    with pytest.raises(
        InputError, match=r"anatomy\.scale_mm must be given for .*, because its size of"
    ):
        press(**changes)
    run = press(**changes, **{"anatomy.scale_mm": 34.3})
    assert "596 tetrahedra, 1475 ml" in run.parts.notes["mesh"]
    series = run.parts.tissue.fields
    assert series.nodes_m[:, 2].max() == pytest.approx(0.0, abs=1e-9)
    assert len(series.node_sets["held"]) > 10
    assert 0.05 < run.trace["model_force_z_N"].max() < 1.0


@pytest.mark.parametrize(
    ("scene", "changes", "sentence"),
    [
        (
            "liver-press",
            {"motion.points_mm": [[0, 0, 60], [0, 0, 40]]},
            "motion must bring the tool to the organ",
        ),
        (
            "liver-press",
            {"motion.points_mm": [[0, 0, -20], [0, 0, -30]]},
            "motion must start outside the organ",
        ),
        (
            "liver-press",
            {"anatomy.held": "plane", "anatomy.held_below_mm": -900.0},
            "anatomy.held must touch the body",
        ),
        (
            "liver-press",
            {"anatomy.held": "part"},
            "anatomy.held_part must be given. Use body",
        ),
        (
            "palpation",
            {"anatomy.nodule_centre_mm": [0, 0, -2]},
            "anatomy.nodule_centre_mm must be at least",
        ),
        (
            "needle",
            {"motion.points_mm": [[0, 0, -5], [0, 0, -9]]},
            "motion must start with the needle's tip outside",
        ),
        (
            "liver-press",
            {"tool.kind": "shell-probe", "tool.file": "nowhere.stl"},
            "tool.file must exist",
        ),
        (
            "liver-press",
            {"organ.material": "kidney", "organ.viscous": True},
            "organ.viscous must be false for kidney",
        ),
        ("palpation", {"organ.parts": {"cyst": 80.0}}, "organ.parts must name parts"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(scene, changes, sentence):
    coarse = {"anatomy.edge_mm": 35.0} if scene == "liver-press" else {}
    with pytest.raises(InputError) as refused:
        simulate(load_scene(scene, coarse | changes))
    assert sentence in str(refused.value) and "\n" not in str(refused.value)


def test_the_note_of_a_needle_names_only_built_in_constants(tmp_path):
    def note(names, **changes):
        entry = 'value = 1.0\nrange = [0.0, 2.0]\nsource = "x"\nconfidence = "H"\n'
        file = tmp_path / "own.toml"
        file.write_text("".join(f"[needle.{name}]\n{entry}" for name in names))
        changes |= {"materials": str(file)} if names else {}
        changes |= {"anatomy.interval_ms": 0.0, "motion.points_mm": [[0, 0, 1], [0, 0, -1]]}
        return simulate(load_scene("needle", changes)).summary["notes"]["needle"]

    names = Materials.cited.constants("needle", "liver")
    own = [f"liver.{name}" for name in names]
    sentences = note([]).split("; ")
    assert sentences[0] == "bovine liver of Okamura 2004, fitted to one needle in one organ"
    assert sentences[1] == "no source for puncture_N and hold_N of the vessel wall"
    left = [name for name in own if name.startswith("liver.static")]
    partly = note([name for name in own if name not in left])
    assert partly.startswith("static_in_N_m, static_out_N_m: bovine liver of Okamura 2004")
    holds = {"anatomy.membrane_holds_N": {"vessel wall": 2.0}}
    assert "the vessel wall holds the shaft with 2 N, more than its puncture" in note([], **holds)
    assert "more than its puncture" not in note([])
    punctures = {"anatomy.membrane_punctures_N": {"vessel wall": 1.0}}
    assert note(own, **punctures).startswith("no source for hold_N of the vessel wall; ")
    assert note([*own, "vessel_wall.hold_N"], **punctures) == (
        "forces across the needle's axis are not modelled"
    )
