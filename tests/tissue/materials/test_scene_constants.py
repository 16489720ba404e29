"""Constants of a person's own file in place of the cited ones."""

import numpy as np
import pytest

from meshes.base.errors import InputError
from tissue.materials.constants import constants
from tissue.materials.scene_constants import Materials, energy_note
from tissue.scene.load import load_scene, saved_text
from tissue.scene.used_constants import used_constants
from tissue.simulation.builders.arguments import given_note

RADIAL = "cutting.bone.radial_chip_N_mm2"


def entry(full, value, low=None, high=None):
    """One constant as a file has it."""
    low, high = (value if low is None else low), (value if high is None else high)
    return (
        f'[{full}]\nvalue = {value}\nrange = [{low}, {high}]\nsource = "a test"\nconfidence = "L"\n'
    )


def written(folder, *texts):
    """A file of constants."""
    path = folder / "own.toml"
    path.write_text("\n".join(texts), "utf-8")
    return path


def test_a_layer_comes_before_its_material(tmp_path):
    given = Materials.read(
        written(tmp_path, entry(RADIAL, 20.0), entry("cutting.trabecular.radial_chip_N_mm2", 7.0))
    )
    plate, vault = given.coefficients(("subchondral", "trabecular"), {})
    assert (plate.radial_chip_Pa, vault.radial_chip_Pa) == (20e6, 7e6)
    scene = load_scene("glenoid", {"materials": given.file})
    used = {
        one.full: one.cited.value for one in used_constants(scene, ("subchondral", "trabecular"))
    }
    assert (used[RADIAL], used["cutting.trabecular.radial_chip_N_mm2"]) == (20.0, 7.0)
    assert RADIAL not in {one.full for one in used_constants(scene, ("trabecular",))}


def test_other_tables_take_their_place(tmp_path):
    path = written(
        tmp_path, entry("soft.liver.modulus_kPa", 9.0), entry("devices.touch.mass_kg", 0.05)
    )
    given = Materials.read(path)
    assert given.constants("soft", "liver")["modulus_kPa"].value == 9.0
    assert (
        given.constants("soft", "liver")["poisson_ratio"]
        == constants("soft", "liver")["poisson_ratio"]
    )
    assert given.numbers("devices", {"mass_kg": 0.04, "rate_Hz": 1000.0}, "touch") == {
        "mass_kg": 0.05,
        "rate_Hz": 1000.0,
    }


def test_a_correlation_is_that_of_the_file_and_zero_elsewhere(tmp_path):
    edge = "cutting.bone.radial_edge_N_mm"
    matrix = f'[correlation]\nnames = ["{RADIAL}", "{edge}"]\nmatrix = [[1.0, -0.8], [-0.8, 1.0]]\n'
    given = Materials.read(written(tmp_path, entry(RADIAL, 20.0), entry(edge, 3.0), matrix))
    found = given.correlation([edge, "cutting.bone.density_exponent", RADIAL])
    np.testing.assert_array_equal(found, [[1.0, 0.0, -0.8], [0.0, 1.0, 0.0], [-0.8, 0.0, 1.0]])


PAIR = f'[correlation]\nnames = ["{RADIAL}", "cutting.bone.radial_edge_N_mm"]\n'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (entry("cuting.bone.radial_chip_N_mm2", 1.0), "did you mean cutting"),
        (entry("soft.livre.modulus_kPa", 1.0), "did you mean liver"),
        (entry("needle.pig.linear_N_mm", 1.0), "Use the listed name that the scene uses"),
        (entry("cutting.bone.radial_chip", 1.0), "did you mean radial_chip_N_mm2"),
        (
            entry(RADIAL, 50.0, 1.0, 2.0),
            r"inside its range, got the value 50 and the range \[1, 2\]",
        ),
        (entry("soft.liver.poisson_ratio", 0.6, 0.5, 0.7), r"inside \[0, 0.5\]"),
        (
            entry(RADIAL, 50.0).replace('source = "a test"', ""),
            r"source must be given in .*own\.toml\. Add it",
        ),
        (entry(RADIAL, 50.0).replace('"a test"', '" "'), "radial_chip_N_mm2.source"),
        (entry(RADIAL, 50.0).replace('"L"', '"X"'), "radial_chip_N_mm2.confidence"),
        (entry(RADIAL, 50.0) + "range = [", "valid TOML file, got .* with the error: "),
        ("cutting = 3", "must be a table"),
        ("", r"contains no constant\. Leave materials out, or add a constant"),
        (
            "# keys of the scene: --set organ.young_kPa=12.29 --set organ.friction=0.2\n",
            r"Leave materials out and set organ\.young_kPa=12\.29 and organ\.friction=0\.2 instead",
        ),
        (
            entry(RADIAL, 5.0)
            + entry("cutting.bone.radial_edge_N_mm", 3.0)
            + PAIR
            + "matrix = [[1.0, 2.0], [2.0, 1.0]]",
            "positive definite",
        ),
        (
            entry(RADIAL, 5.0) + PAIR + "matrix = [[1.0, 0.0], [0.0, 1.0]]",
            "constants of the file in correlation",
        ),
    ],
)
def test_a_bad_file_is_refused_in_a_sentence(text, words, tmp_path):
    with pytest.raises(InputError, match=words):
        Materials.read(written(tmp_path, text))


def test_a_scene_with_a_file_without_constants_is_refused_when_it_is_loaded(tmp_path):
    with pytest.raises(InputError, match="contains no constant"):
        load_scene("palpation", {"materials": str(written(tmp_path, "# nothing"))})


def test_the_scene_of_a_saved_run_is_loaded_without_its_file_of_constants(tmp_path):
    file = written(tmp_path, entry("soft.liver.modulus_kPa", 5.0))
    scene = load_scene("palpation", {"materials": str(file)})
    kept = tmp_path / "scene.toml"
    kept.write_text(saved_text(scene), "utf-8")
    file.unlink()
    assert load_scene(kept) == scene


@pytest.mark.parametrize(
    ("texts", "changes", "words"),
    [
        (
            [entry("soft.liver.modulus_kPa", 5.0)],
            {},
            "Use cutting.bone.tangential_chip_N_mm2, .*; or remove materials",
        ),
        (
            [entry(RADIAL, 5.0)],
            {"cutting.radial_chip_N_mm2": 9.0},
            "cutting.radial_chip_N_mm2 must be left out",
        ),
        ([entry("cutting.trabeclar.radial_chip_N_mm2", 5.0)], {}, "did you mean trabecular"),
    ],
)
def test_a_file_without_effect_is_refused(texts, changes, words, tmp_path):
    scene = load_scene("glenoid", changes | {"materials": str(written(tmp_path, *texts))})
    with pytest.raises(InputError, match=words):
        layers = ("subchondral", "trabecular")
        given_note(scene.constants, used_constants(scene, layers), layers=layers, by="scene")


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (0.06, ""),
        (60.0, "is 1000 times the upper end of the built-in range (0.036-0.06): check its unit"),
        (6e-5, "is 0.0017 times the lower end of the built-in range (0.036-0.06)"),
        (0.0, ""),
    ],
)
def test_constant_far_outside_the_built_in_range_is_noted(value, words, tmp_path):
    full = "needle.liver.linear_N_mm"
    scene = load_scene("needle", {"materials": str(written(tmp_path, entry(full, value)))})
    used = used_constants(scene, ())
    note = given_note(scene.constants, used, layers=(), by="scene")["materials"]
    assert (f"{full} {words}" in note) if words else ("check its unit" not in note)


def test_the_note_on_the_cutting_energy_follows_the_exponents_of_the_scene():
    def note(**changes):
        return energy_note(("cortical",), Materials.cited, changes=changes)

    assert " J/mm3 at 1800 kg/m3, confidence" in note()
    assert " J/mm3 at 1800 kg/m3 and a chip of 100 µm" in note(size_exponent=0.3)
    assert " J/mm3, confidence" in note(density_exponent=0.0)
