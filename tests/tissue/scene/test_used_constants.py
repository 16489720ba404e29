"""Constants of a scene: all that it reads, and effects of the listed ones.

The effect is tested by changing them.
"""

import numpy as np
import pytest

import tissue
from tissue.fitting.fit_files import write_fitted
from tissue.materials.constants import Constant, constants, listed
from tissue.materials.scene_constants import TABLES
from tissue.scene.used_constants import used_constants

PLAIN = {
    "organ.young_kPa": None,
    "organ.young_end_kPa": None,
    "organ.parts": None,
    "organ.interval_ms": 0.0,
}
SCENES = {
    "milling": {"voxels.spacing_mm": 0.4, "duration_s": 0.6},
    "needle": {"anatomy.interval_ms": 0.0},
    "incision": {"anatomy.interval_ms": 0.0, "duration_s": 0.9},
    "palpation": {
        **PLAIN,
        "duration_s": 0.4,
        "anatomy.size_mm": [120, 40, 20],
        "anatomy.nodule_diameter_mm": None,
    },
    "wall": {"device": "touch", "duration_s": 0.8},
}
LIMITS = (
    "stick_band_mm_s",
    "force_slew_N_ms",
    "damping_limit_N_s_m",
    "workspace_",
    "turning_",
    "inertia_kg_m2",
)
"""Constants that count only in cases that none of these runs reaches.

The cases are a limit, rest, and a tool turned by hand.
"""


def other(one):
    """A value of the range that is not the cited one."""
    return one.low if one.low > 0.0 and one.low != one.value else one.high


def figures(name, changes, values, tmp_path):
    """All numbers of a run's trace, with constants changed."""
    if values:
        entries = {
            each: Constant(value, value, value, "a test", "L") for each, value in values.items()
        }
        write_fitted(tmp_path / "changed.toml", entries, np.eye(len(entries)))
        changes = changes | {"materials": str(tmp_path / "changed.toml")}
    scene = tissue.load_scene(name, changes)
    run = tissue.simulate(scene)
    return (
        scene,
        tuple(run.summary["layers"]),
        run.to_pandas().select_dtypes("number").to_numpy(float),
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_listed_constants_change_a_run_and_others_do_not(name, tmp_path):
    scene, layers, plain = figures(name, SCENES[name], {}, tmp_path)
    used = [each for each in used_constants(scene, layers) if each.stated is None]
    for each in used:
        if each.cited.low < each.cited.high and not each.name.startswith(LIMITS):
            changed = figures(name, SCENES[name], {each.full: other(each.cited)}, tmp_path)[2]
            assert not np.array_equal(changed, plain, equal_nan=True), each.full
    require_no_other_counts(name, SCENES[name], used, plain, tmp_path)


def require_no_other_counts(name, changes, used, plain, tmp_path):
    """A run with every constant that is not listed changed is the same run."""
    names = {each.full for each in used}
    unused = {
        f"{table}.{material}.{constant}": other(one)
        for table in TABLES
        for material in listed(table)
        for constant, one in constants(table, material).items()
        if f"{table}.{material}.{constant}" not in names and one.low < one.high
    }
    assert len(unused) > 100
    same = figures(name, changes, unused | {used[0].full: used[0].cited.value}, tmp_path)[2]
    np.testing.assert_array_equal(same, plain)


@pytest.mark.parametrize("has_stress", [False, True])
@pytest.mark.parametrize("has_heat", [False, True])
def test_teeth_list_what_stress_and_heat_read(has_stress, has_heat):
    plain = tissue.load_scene("caries")
    stress = plain.stress or type(plain).model_fields["stress"].annotation.__args__[0]()
    scene = plain.model_copy(update={"stress": stress if has_stress else None, "heat": has_heat})
    layers = ("enamel", "dentin", "caries", "bone")
    names = {each.full for each in used_constants(scene, layers) if each.full.startswith("tooth.")}
    elastic = {
        f"tooth.{layer}.poisson_ratio" for layer in ("enamel", "dentin", "caries", "ligament")
    }
    elastic |= {f"tooth.{layer}.modulus_GPa" for layer in ("enamel", "dentin", "ligament")}
    thermal = {f"tooth.{layer}.{name}" for layer in layers for name in constants("tooth", layer)}
    thermal = {name for name in thermal if not name.endswith(("modulus_GPa", "poisson_ratio"))} | {
        "tooth.bur.heat_share"
    }
    assert names == (elastic if has_stress else set()) | (thermal if has_heat else set())
