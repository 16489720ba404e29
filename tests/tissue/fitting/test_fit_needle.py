"""`tissue fit needle` from a run's own trace with other constants, a bias and a delay."""

import json

import numpy as np
import pytest

import tissue

SCENE = {"anatomy.interval_ms": 0.0, "anatomy.membrane_depths_mm": None}
PLANTED = {"cutting_N": 1.3, "linear_N_mm": 0.052, "capsule_puncture_N": 2.5}


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    folder = tmp_path_factory.mktemp("needle")
    lines = [
        f'[needle.liver.{k}]\nvalue={v}\nrange=[{v},{v}]\nsource="t"\nconfidence="H"\n' for k, v in PLANTED.items()
    ]
    (folder / "planted.toml").write_text("\n".join(lines), "utf-8")
    scene = tissue.load_scene("needle", SCENE | {"materials": str(folder / "planted.toml")})
    table = tissue.simulate(scene).to_pandas()
    rng, times = np.random.default_rng(1), table["time_s"].to_numpy()
    kept = table[["time_s", *(f"tool_{c}_mm" for c in "xyz"), *(f"tool_q{c}" for c in "xyzw")]].copy()
    force = np.interp(times - 0.012, times, table["model_force_z_N"])
    kept["force_z_N"] = force + 0.1 + 0.05 * rng.standard_t(4, size=len(times))
    kept.to_csv(folder / "log.csv", index=False)
    return folder / "log.csv"


@pytest.mark.slow
def test_planted_constants_come_back_as_a_file_for_scenes(log, tmp_path):
    fit = tissue.fit(tissue.load_scene("needle", SCENE), log)
    posterior = fit.fitted.posterior
    assert posterior.converged
    low, high = posterior.offset_interval_s
    assert abs(posterior.nuisances.offset_s - 0.012) < 4.0 * (high - low) / 3.29 < 0.01
    assert posterior.nuisances.bias == pytest.approx([0.1], abs=0.02)
    table = fit.to_pandas()
    for name, planted in PLANTED.items():
        row = table.loc[f"needle.liver.{name}"]
        assert row["state"] != "at its prior", name
        assert abs(row["p50"] - planted) < 4.0 * (row["p95"] - row["p05"]) / 3.29, name
    fit.save(tmp_path / "fit")
    scene = tissue.load_scene("needle", SCENE | {"materials": str(tmp_path / "fit" / "fitted.toml")})
    assert scene.constants.constants("needle", "liver")["cutting_N"].value == pytest.approx(
        json.loads((tmp_path / "fit" / "fit.json").read_text("utf-8"))["constants"][4]["p50"]
    )


def written(path, *, up_mm, channel):
    """A log of a needle that goes 20 mm down and up again, and of no force."""
    times = np.arange(0.0, 2.0, 0.002)
    depth = up_mm - 20.0 * (1.0 - np.abs(times - 1.0))
    rows = np.column_stack([times, 0.0 * times, 0.0 * times, depth, 0.0 * times])
    head = f"time_s,tool_x_mm,tool_y_mm,tool_z_mm,{channel}"
    np.savetxt(path, rows, delimiter=",", header=head, comments="")
    return path


@pytest.mark.parametrize(
    ("up_mm", "channel", "message"),
    [(100.0, "force_z_N", "must bring the needle into the organ"), (5.0, "force_x_N", "the force along the needle")],
)
def test_logs_without_an_insertion_or_its_force_are_refused(tmp_path, up_mm, channel, message):
    with pytest.raises(tissue.InputError, match=message):
        tissue.fit(tissue.load_scene("needle", SCENE), written(tmp_path / "log.csv", up_mm=up_mm, channel=channel))


def test_a_puncture_below_the_cited_range_is_named(tmp_path):
    """A force that rises to 0.5 N over 5 mm and falls to 0.2 N, in a log that ends before the cited puncture."""
    times = np.arange(0.0, 1.0, 0.002)
    depth = 10.0 * times - 1.0
    force = np.where(depth < 5.0, 0.1 * np.maximum(depth, 0.0), 0.2)
    force += 0.002 * np.random.default_rng(0).standard_normal(len(times))
    rows = np.column_stack([times, 0.0 * times, 0.0 * times, -depth, force])
    head = "time_s,tool_x_mm,tool_y_mm,tool_z_mm,force_z_N"
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header=head, comments="")
    with pytest.raises(tissue.InputError, match=r"from 0\.\d+ to 0\.2\d* N at [45]\.?\d* mm, like a puncture"):
        tissue.fit(tissue.load_scene("needle", SCENE), tmp_path / "log.csv")
