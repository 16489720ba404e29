"""Densities of built-in bones, as a scene states them."""

import numpy as np

from tissue import load_scene
from tissue.simulation.builders.cutting import _replaced_note
from tissue.simulation.builders.voxels import anatomy_of
from tissue.simulation.simulate import simulate


def on_the_axis(scene, changes, depths_m):
    """Return layers and densities below the site, at depths along its axis."""
    keys = {f"anatomy.{name}_density_kg_m3": value for name, value in changes.items()}
    anatomy = anatomy_of(load_scene(scene, keys).anatomy, {})
    depth = np.array(depths_m)
    layer, density = anatomy.classify(np.column_stack([0 * depth, 0 * depth, -depth]), depth)
    return [anatomy.layer_names[at] for at in layer], density


def test_a_vertebra_has_a_density_in_cortex_pedicle_and_body():
    densities = {"cortical": 1700.0, "pedicle": 200.0, "trabecular": 120.0}
    layers, density = on_the_axis("pedicle", densities, [0.5e-3, 8e-3, 40e-3])
    assert layers == ["cortical", "trabecular", "trabecular"]
    assert density.tolist() == [1700.0, 200.0, 120.0]


def test_a_glenoid_has_a_density_in_plate_and_vault():
    densities = {"subchondral": 900.0, "trabecular": 150.0}
    layers, density = on_the_axis("glenoid", densities, [0.5e-3, 20e-3, 60e-3])
    assert layers == ["subchondral", "trabecular", "trabecular"]
    # Below the plate the density falls from 450 kg/m3 over 5 mm.
    assert density[0] == 900.0 and density[1] > density[2]
    np.testing.assert_allclose(density[2], 150.0, atol=0.01)


def test_a_coefficient_of_the_scene_that_applies_to_all_layers_of_a_tooth_is_noted():
    coarse = {"voxels.spacing_mm": 0.25, "stress": None, "duration_s": 0.002}
    changed = {"cutting.tangential_chip_N_mm2": 1000.0}
    notes = simulate(load_scene("molar", coarse | changed)).parts.notes
    assert "the scene sets cutting.tangential_chip_N_mm2 for all layers" in notes["cutting"]
    assert "enamel, dentin" in notes["cutting"]
    assert notes["cutting"].endswith("with a table such as [cutting.enamel]")
    assert "cutting" not in simulate(load_scene("molar", coarse)).parts.notes


def test_the_note_names_the_material_of_a_layer_that_has_no_coefficients_of_its_own():
    scene = load_scene("molar", {"cutting.tangential_chip_N_mm2": 1000.0})
    note = _replaced_note(scene, ["ligament", "bone"])["cutting"]
    assert note.endswith("with a table such as [cutting.soft]")
    assert _replaced_note(scene, ["dentin", "caries"]) == {}
