"""Hyperelastic laws of a scene: their constants, their refusals, and runs of them."""

import numpy as np
import pytest

import tissue
from meshes.base.errors import InputError
from tissue.materials.elasticity import lame
from tissue.materials.hyperelasticity import Hyperelastic
from tissue.models.organ.law_window import TOUCHED, window_of
from tissue.scene.load import load_scene
from tissue.scene.organ import Organ
from tissue.simulation.builders.organ import law_of
from tissue.simulation.simulate import simulate

SMALL = {
    "anatomy.size_mm": [50, 50, 30],
    "anatomy.edge_mm": 10.0,
    "anatomy.touch_edge_mm": 6.0,
    "anatomy.nodule_diameter_mm": 0.0,
    "organ.parts": None,
    "organ.young_kPa": 5.0,
    "organ.young_end_kPa": None,
    "organ.friction": 0.0,
    "organ.poisson_ratio": 0.45,
    "organ.interval_ms": 0.0,
    "organ.order": 1,
}


def pressed(depth_mm: float, **changes: object) -> dict[str, object]:
    """A ball of 16 mm on a small slab, straight in."""
    path = {
        "motion.points_mm": [[0, 0, 0.2], [0, 0, -depth_mm], [0, 0, -depth_mm - 0.01]],
        "motion.feed_mm_s": 10.0,
    }
    return SMALL | path | {f"organ.{name}": value for name, value in changes.items()}


LAWS = {
    "neo-hookean": ({}, lambda g, k: Hyperelastic.neo_hookean(g, bulk_Pa=k)),
    "mooney-rivlin": (
        {"second_share": 0.25},
        lambda g, k: Hyperelastic.mooney_rivlin(0.375 * g, 0.125 * g, bulk_Pa=k),
    ),
    "yeoh": (
        {"square_ratio": 0.2, "cube_ratio": 0.1},
        lambda g, k: Hyperelastic.yeoh(0.5 * g, 0.1 * g, 0.05 * g, bulk_Pa=k),
    ),
    "ogden": ({"exponent": 8.0}, lambda g, k: Hyperelastic(k, ((g, 8.0),))),
    "exponential": (
        {"exponential_rate": 3.0},
        lambda g, k: Hyperelastic.exponential(g, 3.0, bulk_Pa=k),
    ),
}


@pytest.mark.parametrize("name", LAWS)
def test_a_law_has_the_small_strains_of_the_moduli(name):
    changes, expected = LAWS[name]
    table = lame(np.array([5e3, 10e3, 2.5e3]), 0.45)
    law, factors = law_of(Organ(law=name, **changes), table)
    shear, bulk = table[0, 1], table[0, 0] + 2.0 / 3.0 * table[0, 1]
    assert law.shear_Pa == pytest.approx(shear)
    assert law.bulk_Pa == pytest.approx(bulk)
    stretch = np.diag([1.3, 0.9, 0.95])
    assert law.stress(stretch) == pytest.approx(expected(shear, bulk).stress(stretch), rel=1e-12)
    assert factors == pytest.approx([1.0, 2.0, 0.5])


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"law": "yeoh"}, "organ.square_ratio must be given with organ.law = yeoh. Set it, or"),
        (
            {"law": "neo-hookean", "gravity": True},
            "organ.law and organ.gravity must not be combined, got neo-hookean and true",
        ),
        (
            {"law": "neo-hookean", "path": "reduced"},
            "organ.law and organ.path must not be combined, got neo-hookean and reduced",
        ),
        (
            {"law": "neo-hookean", "fibre_direction": (1, 0, 0), "fibre_modulus_ratio": 2.0},
            "organ.law and organ.fibre_direction must not be combined",
        ),
    ],
)
def test_what_a_law_cannot_have_is_refused(changes, sentence):
    with pytest.raises(InputError, match=sentence):
        law_of(Organ(**changes), lame(np.array([5e3]), 0.45))


@pytest.mark.parametrize("others", [{}, {"capsule": True, "viscous": True}])
def test_at_a_small_depth_a_law_gives_the_force_of_the_linear_one(others):
    forces = [
        simulate(load_scene("palpation", pressed(0.1, **law, **others)), cores=1).trace[
            "model_force_z_N"
        ]
        for law in ({}, {"law": "neo-hookean"})
    ]
    np.testing.assert_allclose(forces[1], forces[0], atol=1e-3 * forces[0].max())


def test_frames_of_a_relaxing_law_carry_the_force():
    """Reactions balance the force of the tool while it is held and when it leaves."""
    path = {"motion.points_mm": [[0, 0, 0.2], [0, 0, -3], [0, 0, 0.5]], "motion.feed_mm_s": 20.0}
    given = {"law": "neo-hookean", "capsule": True, "viscous": True, "interval_ms": 50.0}
    run = simulate(load_scene("palpation", pressed(3.0, **given) | path), cores=1)
    force_N = run.trace["model_force_z_N"]
    loaded = 0
    for frame in run.parts.tissue.fields.frames:
        # The force is that of the last row if the frame is at the end.
        on_tool = force_N[min(round(frame.time_s * 1e3), len(force_N) - 1)]
        if on_tool > 0.02:
            carried = frame.points["reaction_N"][:, 2].sum()
            assert carried == pytest.approx(on_tool, rel=0.015)
            loaded += 1
    assert loaded >= 3


class Real:
    """Device that follows the wall clock and presses 3 mm deep."""

    real_time = True

    def read(self, time_s):
        return tissue.Sample(time_s, (0.0, 0.0, 2e-4 - 3.2e-3 * min(time_s / 0.2, 1.0)))

    def command(self, force_N, torque_Nm):
        """Do nothing."""


@pytest.mark.slow
def test_a_real_device_does_not_wait_for_a_law():
    changes = pressed(3.0, law="neo-hookean") | {"device": "touch"}
    # Held for long: on a loaded machine a solve takes half a second.
    held = load_scene("palpation", changes | {"duration_s": 2.0})
    run = tissue.simulate(held, device=Real(), cores=1)
    assert not run.parts.tissue.waits
    assert run.summary["law"]["solves"] > 0
    scene = load_scene("palpation", changes | {"duration_s": 0.4})
    waited = tissue.simulate(scene, device=Waiting(), cores=1)
    assert waited.parts.tissue.waits
    force_N = waited.trace["model_force_z_N"][-1]
    assert run.trace["model_force_z_N"][-1] == pytest.approx(force_N, rel=0.02)


class Waiting(Real):
    """Device that makes the same motion without a clock."""

    real_time = False


def test_a_stated_modulus_leaves_the_cited_rate_of_a_material_in_use():
    """The material is refused only where neither its moduli nor its rate are used."""
    stated = SMALL | {"organ.law": "exponential", "organ.material": "pressed_liver"}
    assert load_scene("palpation", stated).organ.exponential_rate is None
    with pytest.raises(InputError, match="material must be left out with both"):
        load_scene("palpation", stated | {"organ.exponential_rate": 3.0})


def test_an_exponent_of_zero_is_refused_with_the_scene():
    with pytest.raises(InputError, match=r"organ\.exponent must not be 0\. Use"):
        load_scene("palpation", {"organ.law": "ogden", "organ.exponent": 0.0})


def test_a_small_tool_between_the_nodes_of_a_coarse_mesh_has_a_window():
    """The nearest node is 2.2 radii away, where the region ends at 2 radii."""
    place = {
        "tool.diameter_mm": 1.45,
        "anatomy.size_mm": [40, 40, 20],
        "anatomy.edge_mm": 8.0,
        "anatomy.touch_edge_mm": 3.9,
        "motion.points_mm": [[2.1, 0.4, 1.0], [2.1, 0.4, -0.5]],
        "motion.feed_mm_s": 20.0,
    }
    run = simulate(load_scene("palpation", pressed(0.1, law="neo-hookean") | place), cores=1)
    assert run.summary["law"]["solves"] > 0
    assert run.summary["law"]["not_reached"] == 0


def test_no_node_under_a_tool_is_on_the_border_of_a_region(monkeypatch):
    """On edges as long as the tool, a region still has every node that a contact may reach."""
    windows = []

    def spied(organ, law, touchable, centre_m, radius_m):
        window = window_of(organ, law, touchable, centre_m, radius_m)
        from_centre = np.linalg.norm(organ.space.nodes_m[touchable] - centre_m, axis=1)
        windows.append((window, from_centre, TOUCHED * radius_m))
        return window

    monkeypatch.setattr("tissue.models.organ.law_window.window_of", spied)
    changes = pressed(2.0, law="neo-hookean") | {
        "tool.diameter_mm": 10.0,
        "anatomy.edge_mm": 10.0,
        "anatomy.touch_edge_mm": 10.0,
    }
    run = simulate(load_scene("palpation", changes), cores=1)
    assert run.trace["model_force_z_N"].max() > 0.0
    assert windows
    for window, from_centre, reach_m in windows:
        inside = np.isin(np.arange(len(from_centre)), window.inside)
        assert inside[from_centre <= max(reach_m, from_centre.min())].all()


@pytest.mark.slow
def test_frames_in_a_region_are_those_of_the_law_in_the_whole_organ(monkeypatch):
    """Displacement, stress and the force on the supports of the last frame."""
    changes = pressed(1.6, law="neo-hookean", interval_ms=160.0) | {
        "tool.diameter_mm": 8.0,
        "anatomy.touch_edge_mm": 5.0,
        "organ.order": 2,
    }
    scene = load_scene("palpation", changes)
    in_region = simulate(scene, cores=1).parts.fields.frames[-1]
    monkeypatch.setattr("tissue.simulation.builders.organ.REGION", np.inf)
    whole = simulate(scene, cores=1).parts.fields.frames[-1]
    assert in_region.time_s == whole.time_s >= 0.16
    for name, allowed in (("displacement_mm", 0.02), ("reaction_N", 0.02)):
        expected = whole.points[name]
        error = np.abs(in_region.points[name] - expected).max()
        assert error < allowed * np.abs(expected).max(), name
    for name, allowed in (("von_mises_kPa", 0.03), ("strain_percent", 0.03)):
        expected = whole.cells[name]
        error = np.abs(in_region.cells[name] - expected).max()
        assert error < allowed * np.abs(expected).max(), name
    total = in_region.points["reaction_N"].sum(axis=0)
    assert total == pytest.approx(whole.points["reaction_N"].sum(axis=0), rel=0.01, abs=1e-3)


def test_a_force_falls_smoothly_when_a_ball_lifts_off_after_a_slide():
    """The slope of the offset must not join two places on the organ."""
    changes = {
        "anatomy.edge_mm": 22.0,
        "anatomy.touch_edge_mm": 8.0,
        "organ.order": 1,
        "organ.interval_ms": 0.0,
        "motion.points_mm": [[0, 0, 0.5], [0, 0, -6], [15, 0, -6], [15, 0, -4]],
        "motion.feed_mm_s": 30.0,
    }
    run = simulate(load_scene("liver-press", changes), cores=1)
    force_N = run.trace["model_force_z_N"]
    lifting = force_N[np.argmax(run.trace["tool_x_mm"] > 14.999) :]
    rise_N = np.maximum(np.diff(lifting), 0.0).sum()
    assert rise_N < 0.01 * force_N.max()
