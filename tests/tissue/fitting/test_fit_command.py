"""`tissue fit` from a run's own trace with other coefficients.

The planted values are recovered, into a file for scenes.
"""

import json

import numpy as np
import pytest

import tissue

SCENE = {"voxels.spacing_mm": 0.5, "duration_s": 0.7}
PLANTED = {
    "tangential_chip_N_mm2": 110.0,
    "radial_chip_N_mm2": 80.0,
    "tangential_edge_N_mm": 3.0,
    "radial_edge_N_mm": 6.0,
}


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A run with planted coefficients as a log, with noise, a bias and a delay of 6 ms."""
    folder = tmp_path_factory.mktemp("log")
    scene = tissue.load_scene(
        "milling", SCENE | {f"cutting.{name}": value for name, value in PLANTED.items()}
    )
    table = tissue.simulate(scene).to_pandas()
    rng = np.random.default_rng(1)
    times = table["time_s"].to_numpy()
    kept = table[
        ["time_s", *(f"tool_{c}_mm" for c in "xyz"), *(f"tool_q{c}" for c in "xyzw")]
    ].copy()
    for c in "xyz":
        force = np.interp(times - 0.006, times, table[f"model_force_{c}_N"])
        kept[f"force_{c}_N"] = force + 0.5 + 0.05 * rng.standard_t(4, size=len(times))
    kept.to_csv(folder / "log.csv", index=False)
    return folder / "log.csv"


@pytest.mark.slow
def test_planted_coefficients_come_back_as_a_file_for_scenes(log, tmp_path, command):
    options = [f"--set={name}={value}" for name, value in SCENE.items()]
    code, text, problem = command(
        "fit", "milling", *options, "--measured", log, "--out", tmp_path / "fit"
    )
    assert code == 0, problem
    assert "not narrowed by this log" in text and "to measure next" in text
    found = json.loads((tmp_path / "fit" / "fit.json").read_text("utf-8"))
    assert found["converged"] and found["offset_s"][1] == pytest.approx(0.006, abs=0.001)
    assert found["bias"] == pytest.approx([0.5] * 3, abs=0.1)
    for each in found["constants"]:
        planted = PLANTED.get(each["name"].rpartition(".")[2])
        if planted is None:
            continue
        spread = (each["p95"] - each["p05"]) / 3.29
        assert abs(each["p50"] - planted) < 4.0 * spread, each
    report = (tmp_path / "fit" / "report.html").read_text("utf-8")
    assert "http" not in report.replace("http-equiv", "") and report.count("<img") == 2
    code, _, message = command(
        "fit", "milling", *options, "--measured", log, "--out", tmp_path / "fit"
    )
    assert code == 2 and "--overwrite" in message


def test_other_scenes_are_refused(log, tmp_path, refused):
    message = refused("fit", "wall", "--measured", log, "--out", tmp_path / "fit")
    assert message.startswith(
        "scene must have constants that can be fitted, got anatomy.kind = wall"
    )
