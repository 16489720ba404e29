"""Entry into a tooth from files over its lesion.

A run that misses the lesion reports how to reach it.
"""

import pytest
import trimesh

from tissue import InputError, load_scene, simulate

STRAIGHT_IN = {
    "voxels.spacing_mm": 0.2,
    "voxels.margin_mm": 1.0,
    "stress": None,
    "tool.diameter_mm": 1.5,
    "motion.points_mm": [[0, 0, 1.5], [0, 0, -1.5]],
    "motion.feed_mm_s": 20.0,
    "duration_s": None,
}


@pytest.fixture
def layers(tmp_path):
    """Write enamel on hollow dentin with a pulp in it, and decay.

    The decay lies 0.4 mm under the dentin's side at x = 4 [mm].
    """

    def block(size, x, bottom):
        return trimesh.creation.box(size).apply_translation((x, 0.0, bottom + 0.5 * size[2]))

    hollow = block((2, 2, 6), 0, 4)
    hollow.invert()
    bodies = {
        "enamel": block((8, 6, 3), 0, 12),
        "dentin": trimesh.util.concatenate([block((8, 6, 12), 0, 0), hollow]),
        "pulp": block((2, 2, 6), 0, 4),
        "caries": block((1.4, 1.4, 1.4), 2.9, 7),
    }
    for name, body in bodies.items():
        body.export(tmp_path / f"{name}.stl")
    return {f"anatomy.{name}_file": str(tmp_path / f"{name}.stl") for name in bodies}


@pytest.mark.slow
def test_surfaces_are_drilled_over_their_caries_or_refused_with_the_remedy(layers):
    run = simulate(load_scene("molar", layers | STRAIGHT_IN | {"anatomy.site": "caries"})).summary
    assert run["removed_mm3"]["caries"] > 0.5 and run["removed_mm3"]["enamel"] == 0.0
    missed = simulate(load_scene("molar", layers | STRAIGHT_IN)).summary
    assert missed["removed_mm3"]["enamel"] > 0.5 and missed["removed_mm3"]["caries"] == 0.0
    assert "no caries" in missed["notes"]["removed"]
    assert "set anatomy.site = caries, or move motion.points_mm" in missed["notes"]["removed"]
    shallow = {"anatomy.site": "caries", "motion.points_mm": [[0, 0, 1.5], [0, 0, -0.7]]}
    touched = simulate(load_scene("molar", layers | STRAIGHT_IN | shallow)).summary
    removed, there = touched["removed_mm3"]["caries"], touched["start_mm3"]["caries"]
    assert 0.0 < removed < 0.5 * there
    assert touched["notes"]["removed"].startswith(
        f"only {removed:.3g} of {there:.3g} mm3 of the caries within reach"
    )


def test_the_pulp_of_a_tooth_from_surfaces_is_kept_clear_of_by_name_as_by_file(layers):
    scene = layers | STRAIGHT_IN | {"duration_s": 0.03}
    by_name = simulate(load_scene("molar", scene | {"keep_clear.names": ["pulp"]}))
    files = {"keep_clear.files": {"pulp": layers["anatomy.pulp_file"]}}
    by_file = simulate(load_scene("molar", scene | files))
    assert (by_name.trace["distance_pulp_mm"] == by_file.trace["distance_pulp_mm"]).all()
    assert by_name.summary["keep_clear"] == by_file.summary["keep_clear"]
    assert 0.0 < by_name.summary["keep_clear"]["pulp"]["least_distance_mm"] < 10.0


def test_a_structure_that_the_tooth_does_not_have_is_refused_with_the_remedy(layers):
    scene = layers | STRAIGHT_IN | {"duration_s": 0.01}
    without = scene | {"anatomy.pulp_file": None}
    for changes, remedy in (
        (without | {"keep_clear.names": ["pulp"]}, "Set anatomy.pulp_file"),
        (
            without | {"keep_clear.names": ["nerve"]},
            r"Give a surface of nerve in \[keep_clear.files\]",
        ),
        (scene | {"keep_clear.names": ["nerve"]}, r"\(pulp\), got nerve. Use pulp, or give"),
    ):
        with pytest.raises(InputError, match=remedy):
            simulate(load_scene("molar", changes))


def test_a_path_in_the_frame_of_the_files_has_the_transform_in_its_message(layers):
    away = {"motion.points_mm": [[160, 120, 60], [160, 120, 58]], "duration_s": 0.01}
    with pytest.raises(InputError, match=r"in the frame of .* placement\.file_to_scene_mm"):
        simulate(load_scene("molar", layers | STRAIGHT_IN | away))
