"""`tissue fit` of an organ: modulus and friction of a slab come back from a run with noise, bias and delay."""

import numpy as np
import pytest

import tissue

SCENE = {
    "anatomy.size_mm": [50, 40, 20], "anatomy.nodule_diameter_mm": None, "anatomy.edge_mm": 8.0,
    "anatomy.touch_edge_mm": 5.0, "organ.young_kPa": None, "organ.young_end_kPa": None, "organ.parts": None,
    "organ.interval_ms": 0.0, "organ.friction": 0.3, "organ.poisson_ratio": 0.48,
    "motion.points_mm": [[-8, 0, 1], [-8, 0, -2], [8, 0, -2], [8, 0, 1]],
}  # fmt: skip


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    folder = tmp_path_factory.mktemp("organ")
    text = '[soft.liver.modulus_kPa]\nvalue=8.0\nrange=[8.0,8.0]\nsource="t"\nconfidence="H"\n'
    (folder / "planted.toml").write_text(text, "utf-8")
    planted = {"materials": str(folder / "planted.toml"), "organ.friction": 0.2}
    table = tissue.simulate(tissue.load_scene("palpation", SCENE | planted)).to_pandas()
    rng, times = np.random.default_rng(2), table["time_s"].to_numpy()
    kept = table[["time_s", *(f"tool_{c}_mm" for c in "xyz")]].copy()
    for c in "xyz":
        force = np.interp(times - 0.008, times, table[f"model_force_{c}_N"])
        kept[f"force_{c}_N"] = force + 0.02 + 0.01 * rng.standard_t(4, size=len(times))
    kept.to_csv(folder / "log.csv", index=False)
    return folder / "log.csv"


@pytest.mark.slow
def test_modulus_and_friction_come_back(log, tmp_path):
    fit = tissue.fit(tissue.load_scene("palpation", SCENE), log, cores=1)
    posterior, table = fit.fitted.posterior, fit.to_pandas()
    assert posterior.converged and posterior.names == ("soft.liver.modulus_kPa", "organ.friction")
    for name, planted in (("soft.liver.modulus_kPa", 8.0), ("organ.friction", 0.2)):
        row = table.loc[name]
        assert row["state"] == "determined"
        assert abs(row["p50"] - planted) < 4.0 * (row["p95"] - row["p05"]) / 3.29
    assert posterior.nuisances.bias == pytest.approx([0.02] * 3, abs=0.01)
    assert "to be set in the scene: organ.friction" in " ".join(fit.fitted.sentences)
    fit.save(tmp_path / "fit")
    text = (tmp_path / "fit" / "fitted.toml").read_text("utf-8")
    assert "modulus_kPa" in text and "friction" not in text


@pytest.mark.slow
def test_a_log_that_never_touches_is_refused(log, tmp_path):
    import pandas

    table = pandas.read_csv(log)
    table["tool_z_mm"] += 50.0
    table.to_csv(tmp_path / "air.csv", index=False)
    with pytest.raises(tissue.InputError, match="measured must bring"):
        tissue.fit(tissue.load_scene("palpation", SCENE), tmp_path / "air.csv", cores=1)
