"""`tissue fit` of an organ.

Modulus and friction of a slab are recovered from a run with noise, bias and delay.
"""

import re
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from planted_logs import TIMES_S, slot
from planted_logs import planted as planted_log

import tissue
from tissue.fitting.fit import fit_scene
from tissue.fitting.log_files import CHANNELS
from tissue.fitting.organ_problem import FARTHEST
from tissue.fitting.organ_runs import OrganRuns, Poses, organ_parameters
from tissue.fitting.problem import Problem
from tissue.materials.constants import Z_95
from tissue.scene.load import changed

SCENE = {
    "anatomy.size_mm": [50, 40, 20],
    "anatomy.nodule_diameter_mm": None,
    "anatomy.edge_mm": 8.0,
    "anatomy.touch_edge_mm": 5.0,
    "organ.young_kPa": None,
    "organ.young_end_kPa": None,
    "organ.parts": None,
    "organ.interval_ms": 0.0,
    "organ.friction": 0.3,
    "organ.poisson_ratio": 0.48,
    "motion.points_mm": [[-8, 0, 1], [-8, 0, -2], [8, 0, -2], [8, 0, 1]],
}


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    folder = tmp_path_factory.mktemp("organ")
    text = '[soft.liver.modulus_kPa]\nvalue=8.0\nrange=[8.0,8.0]\nsource="t"\nconfidence="H"\n'
    (folder / "planted.toml").write_text(text, "utf-8")
    planted = {"materials": str(folder / "planted.toml"), "organ.friction": 0.2}
    table = tissue.simulate(tissue.load_scene("palpation", SCENE | planted)).to_pandas()
    rng = np.random.default_rng(2)
    times = table["time_s"].to_numpy()
    kept = table[["time_s", *(f"tool_{c}_mm" for c in "xyz")]].copy()
    for c in "xyz":
        force = np.interp(times - 0.008, times, table[f"model_force_{c}_N"])
        kept[f"force_{c}_N"] = force + 0.02 + 0.01 * rng.standard_t(4, size=len(times))
    kept.to_csv(folder / "log.csv", index=False)
    return folder / "log.csv"


@pytest.mark.slow
def test_modulus_and_friction_come_back(log, tmp_path):
    fit = tissue.fit(tissue.load_scene("palpation", SCENE), log, cores=1)
    posterior = fit.fitted.posterior
    table = fit.to_pandas()
    assert posterior.converged and posterior.names == ("soft.liver.modulus_kPa", "organ.friction")
    for name, planted in (("soft.liver.modulus_kPa", 8.0), ("organ.friction", 0.2)):
        row = table.loc[name]
        assert row["state"] == "determined"
        assert abs(row["p50"] - planted) < 4.0 * (row["p95"] - row["p05"]) / 3.29
    assert posterior.nuisances.bias == pytest.approx([0.02] * 3, abs=0.01)
    friction = table.loc["organ.friction", "p50"]
    assert f"not in fitted.toml: --set organ.friction={friction:.4g}" in " ".join(
        fit.fitted.sentences
    )
    fit.save(tmp_path / "fit")
    text = (tmp_path / "fit" / "fitted.toml").read_text("utf-8")
    stated = str(tomllib.loads(text))
    assert "modulus_kPa" in stated and "friction" not in stated


@pytest.mark.slow
def test_forces_in_kilonewtons_that_are_read_in_newtons_are_named(log, tmp_path):
    """The modulus is then a thousand times too small, for which a mesh may not be fine enough."""
    table = np.loadtxt(log, delimiter=",", skiprows=1)
    write_log(tmp_path / "kN.csv", table[:, 0], table[:, 1:4], 1e-3 * table[:, 4:])
    scene = tissue.load_scene("palpation", SCENE)
    try:
        stated = " ".join(tissue.fit(scene, tmp_path / "kN.csv", cores=1).fitted.doubts)
    except tissue.InputError as error:
        stated = str(error)
    assert re.search(r"modulus_kPa = \S+ is \d+ times below its range .* in kN that are", stated)


def test_a_log_that_never_touches_is_refused(tmp_path):
    times = np.arange(0.0, 1.0, 1e-3)
    forces = np.random.default_rng(0).standard_normal((1000, 3))
    tips = np.column_stack([20.0 * times, 0.0 * times, 30.0 + 0.0 * times])
    write_log(tmp_path / "air.csv", times, tips, forces)
    with pytest.raises(tissue.InputError, match="measured must bring the tool to the organ"):
        tissue.fit(tissue.load_scene("palpation", SCENE), tmp_path / "air.csv", cores=1)


def write_log(path, times, tips, forces):
    head = "time_s,tool_x_mm,tool_y_mm,tool_z_mm,force_x_N,force_y_N,force_z_N"
    np.savetxt(
        path, np.column_stack([times, tips, forces]), delimiter=",", header=head, comments=""
    )


def pressed(path, changes, corners_mm, times_s, planted, *, noise_N, seed):
    """Return a slab scene with changes, and the log of a ball along a path with planted constants.

    The log has noise.
    """
    scene = tissue.load_scene("palpation", SCENE | changes)
    upright = np.tile([0.0, 0.0, 0.0, 1.0], (len(times_s), 1))
    poses = Poses(np.array(times_s), 1e-3 * np.array(corners_mm), upright)
    (loads,) = OrganRuns(scene, poses, CHANNELS[:3])([planted])
    times = 1e-3 * np.arange(len(loads))
    tips = np.column_stack(
        [np.interp(times, times_s, each) for each in np.array(corners_mm, dtype=float).T]
    )
    write_log(
        path, times, tips, loads + noise_N * np.random.default_rng(seed).standard_t(4, loads.shape)
    )
    return scene


def assert_found(table, planted):
    """Each constant is determined, and within four standard deviations of what was planted."""
    assert set(table.index) == set(planted)
    for name, value in planted.items():
        row = table.loc[name]
        assert row["state"] == "determined", name
        assert abs(row["p50"] - value) < 4.0 * (row["p95"] - row["p05"]) / 3.29, name


VISCOUS = {"organ.viscous": True, "organ.poisson_ratio": None}
PRONY = {"prony_g1": 0.27, "prony_tau1_s": 0.045, "prony_g2": 0.3, "prony_tau2_s": 0.4}


@pytest.mark.slow
def test_a_prony_series_comes_back_from_a_held_press(tmp_path):
    planted = {f"soft.liver.{name}": value for name, value in PRONY.items()}
    corners = [[0, 0, 0.5], [0, 0, -3], [0, 0, -3], [0, 0, -1], [0, 0, -1]]
    scene = pressed(
        tmp_path / "log.csv",
        VISCOUS,
        corners,
        [0.0, 0.03, 0.6, 0.63, 0.9],
        planted,
        noise_N=5e-4,
        seed=4,
    )
    fit = tissue.fit(scene, tmp_path / "log.csv", free=["soft.prony"], cores=1)
    assert_found(fit.to_pandas(), planted)


STIFFENING = {
    "organ.law": "ogden",
    "organ.exponent": 12.0,
    "organ.friction": 0.0,
    "organ.order": 1,
    "organ.young_kPa": 8.0,
    "organ.poisson_ratio": 0.45,
}


@pytest.mark.slow
def test_modulus_and_exponent_of_a_hyperelastic_law_come_back_from_a_deep_press(tmp_path):
    corners = [[0, 0, 0.5], [0, 0, -5], [0, 0, -5], [0, 0, -1]]
    times = [0.0, 0.4, 0.6, 0.9]
    planted = {"organ.young_kPa": 6.0, "organ.exponent": 18.0}
    scene = pressed(tmp_path / "log.csv", STIFFENING, corners, times, planted, noise_N=2e-3, seed=7)
    fit = tissue.fit(scene, tmp_path / "log.csv", cores=1)
    posterior = fit.fitted.posterior
    # The error of these coarse cells makes the intervals wide; the log shares the cells.
    for at, (name, value) in enumerate(planted.items()):
        found = posterior.priors[at].x(posterior.mean_z[at])
        deviation = np.sqrt(posterior.covariance[at, at]) * posterior.priors[at].slope(0.0)
        assert abs(found - value) < 4.0 * deviation, name
        row = fit.to_pandas().loc[name]
        assert row["p05"] < value < row["p95"]


@pytest.mark.parametrize("value", [0.1, 0.3, 0.5, 0.9, 0.99])
def test_every_run_of_a_fit_has_a_share_that_a_scene_may_have(value):
    scene = tissue.load_scene(
        "palpation", SCENE | {"organ.law": "mooney-rivlin", "organ.second_share": value}
    )
    parameters, _ = organ_parameters(scene, ["organ.second_share"])
    prior = parameters[0].prior
    assert float(prior.x(0.0)) == pytest.approx(value, rel=1e-12)
    for z in (-FARTHEST, -Z_95, Z_95, FARTHEST):
        x = float(prior.x(z))
        assert 0.0 < x < 1.0 and prior.z(x) == pytest.approx(z, abs=1e-6)
        assert changed(scene, {"organ.second_share": x}).organ.second_share == x


FINE = {"anatomy.edge_mm": 5.0, "anatomy.touch_edge_mm": 3.0}
DEEP = {"organ.young_kPa": 6.0, "organ.exponent": 14.0}


@pytest.fixture(scope="module")
def fine_log(tmp_path_factory):
    """Log of a deep press of a fine mesh with the constants `DEEP`."""
    path = tmp_path_factory.mktemp("fine") / "log.csv"
    corners = [[0, 0, 0.5], [0, 0, -5], [0, 0, -5], [0, 0, -1]]
    times = [0.0, 0.25, 0.4, 0.6]
    pressed(path, STIFFENING | FINE, corners, times, DEEP, noise_N=2e-3, seed=7)
    return path


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_intervals_contain_the_error_of_the_mesh(fine_log):
    """A log of a finer mesh: the intervals of the noise alone miss the planted constants."""
    coarse = {"anatomy.edge_mm": 7.0, "anatomy.touch_edge_mm": 4.4}
    scene = tissue.load_scene("palpation", SCENE | STIFFENING | coarse)
    fit = tissue.fit(scene, fine_log, cores=1)
    posterior = fit.fitted.posterior
    table = fit.to_pandas()
    print(table[["p05", "p50", "p95"]], fit.fitted.sentences)
    assert any("intervals contain this change" in each for each in fit.fitted.sentences)
    for name, value in DEEP.items():
        assert table.loc[name, "p05"] < value < table.loc[name, "p95"]
    alone = np.sqrt(posterior.covariance[0, 0])
    assert abs(posterior.mesh_z[0]) > 3.0 * alone


def test_a_mesh_that_hides_every_constant_is_named(monkeypatch):
    """The log determines the constant, but a finer mesh has half of the loads."""
    whole = slot()
    forward = replace(
        whole, parameters=whole.parameters[:1], times_s=TIMES_S[::5], basis=whole.basis[::5, :, :1]
    )
    measured, _ = planted_log(forward, np.random.default_rng(5), z=[0.0], scale=0.02)
    finer = (replace(forward, basis=0.5 * forward.basis),) * 2
    problem = Problem(forward, measured, 0.05, dict, finer=finer, mesh_factor=2.0)
    monkeypatch.setattr("tissue.fitting.fit.organ_problem", lambda *_, **__: problem)
    log = SimpleNamespace(path=Path("log.csv"), notes=(), channels=forward.channels)
    with pytest.raises(tissue.InputError, match="touch_edge_mm must be small enough"):
        fit_scene(tissue.load_scene("palpation"), log)
    problem = replace(problem, finer=None)
    assert fit_scene(tissue.load_scene("palpation"), log).constants[0].state == "determined"
