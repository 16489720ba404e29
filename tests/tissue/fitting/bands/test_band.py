"""The band of a milled scene, against closed forms, reruns and its files."""

import json

import numpy as np
import pytest
from scene_kinds import kinds, write_files
from scipy.special import ndtri

from meshes.base.errors import InputError
from tissue.fitting.bands.band import band_of, require_band
from tissue.fitting.bands.sample_loads import LEVELS, LOADS, Reweighed
from tissue.materials.constants import constants
from tissue.objects.run import open_run
from tissue.objects.simulate import simulate
from tissue.scene.load import changed
from tissue.scene.scene import Scene
from tissue.show.report.page import band_lines
from tissue.simulation.load_record import record_loads

NAMES = tuple(constants("cutting", "bone"))


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    return kinds(write_files(tmp_path_factory.mktemp("files")))


@pytest.fixture(scope="module")
def block(tables):
    return Scene(**tables["block"])


def test_of_a_force_linear_in_one_coefficient_the_band_is_that_of_the_coefficient(block):
    """The band of a force that is linear in one coefficient is the coefficient's band.

    All other coefficients are 0 or fixed by the scene, so that each figure is the coefficient times
    a geometry.
    """
    fixed = dict.fromkeys(
        (
            f"cutting.{name}"
            for name in NAMES
            if ("chip" in name or "edge" in name) and not name.startswith("reference")
        ),
        0.0,
    )
    del fixed["cutting.radial_edge_N_mm"]
    scene = changed(block, fixed)
    reweighed = Reweighed(record_loads(scene, cores=1))
    at = reweighed.ranges.names.index("cutting.bone.radial_edge_N_mm")
    prior = reweighed.ranges.priors[at]
    levels = np.array(list(LEVELS.values()))
    count = 4096
    x = np.tile(reweighed.nominal(), (count, 1))
    x[:, at] = prior.x(ndtri((np.arange(count) + 0.5) / count))
    per_unit = reweighed.figures(reweighed.nominal()[None])[0] / reweighed.nominal()[at]
    exact = np.outer(prior.x(ndtri(levels)), per_unit)
    found = np.quantile(reweighed.figures(x), levels, axis=0, method="hazen")
    assert found == pytest.approx(exact, rel=1e-4, abs=1e-12)
    assert per_unit[0] > 0.0
    size = reweighed.quantiles(x[8::16], tuple(levels))[..., 3]
    assert size[:, np.argmax(size[2])] == pytest.approx(exact[:, 0], rel=3e-2)


def test_in_bone_of_the_reference_density_the_exponent_counts_where_that_density_varies(block):
    """In bone of the reference density the exponent counts where that density varies.

    The strength is the ratio of the densities to the exponent: 1 for both cited values, not for
    both of a sample.
    """
    reweighed = Reweighed(record_loads(block, cores=1))
    names = reweighed.ranges.names
    priors = reweighed.ranges.priors
    density, exponent = (
        names.index(f"cutting.bone.{name}")
        for name in ("reference_density_kg_m3", "density_exponent")
    )
    x = np.tile(reweighed.nominal(), (3, 1))
    x[1:, density] = priors[density].high
    x[2, exponent] = priors[exponent].high
    peak = reweighed.figures(x)[:, 0]
    ratio = priors[density].value / priors[density].high
    assert peak[1:] / peak[0] == pytest.approx(
        [ratio ** priors[exponent].value, ratio ** priors[exponent].high]
    )


@pytest.fixture(scope="module")
def wide(block):
    """Band of the cited constants."""
    return band_of(block, 16, cores=1)


def test_the_file_of_a_sample_gives_its_figures_when_it_is_run(block, wide, tmp_path):
    """Reweighed against rerun, for every constant at once.

    Loads are interpolated between nodes of chip thickness, with an error of 0.2 % at most.
    """
    band = wide
    for number in (3, 11):
        file = tmp_path / "sample.toml"
        file.write_text(band.files[number], "utf-8")
        summary = simulate(changed(block, {"materials": str(file)}), cores=1).summary
        want = [summary[outer][inner] for outer, inner in LOADS]
        assert band.figures[number] == pytest.approx(want, rel=2e-3)
        assert band.figures[number] != pytest.approx(band.figures[number - 1], rel=0.01)


def test_a_band_is_written_with_its_run_and_read_back(block, tmp_path):
    run = simulate(block, cores=1)
    band = run.band(30, cores=1)
    assert band.summary["asked"] == 30
    reason = "does not vary with the constants, because the path is given"
    names = "removed_mm3, contact_share, break_through, events"
    assert f"without a band: {names} ({reason})" in band_lines(band.summary)
    assert band.summary["samples"] == len(band.values) == 32
    assert (np.diff(band.quantiles, axis=0) >= 0.0).all()
    peak = run.summary["band"]["force_N"]["peak"]
    assert peak["p05"] < peak["p25"] < peak["p50"] < peak["p75"] < peak["p95"]
    assert peak["p05"] < run.summary["force_N"]["peak"] < peak["p95"]
    totals = [index["total"] for index in run.summary["band"]["sobol"]["force_N.peak"].values()]
    assert 0.95 < sum(totals) < 1.5
    assert "total Sobol indices of the peak force: " in next(band_lines(run.summary["band"]))
    run.save(tmp_path / "run", pictures=False)
    held = open_run(tmp_path / "run")
    again = held.band()
    assert again.constants == band.constants
    assert (
        again.summary
        == json.loads((tmp_path / "run/summary.json").read_text())["band"]
        == band.summary
    )
    for name in ("times_s", "nominal", "quantiles", "values", "figures", "numbers"):
        assert getattr(again, name) == pytest.approx(getattr(band, name), rel=1e-8, abs=1e-12)


def test_what_a_band_cannot_use_is_refused(tables, block):
    with pytest.raises(
        InputError, match="band must be left out for a scene whose constants have no range"
    ):
        band_of(Scene(**tables["wall"]), 16)
    with pytest.raises(InputError, match="band must be"):
        require_band(block, 3, None)
    with pytest.raises(InputError, match="workers must be left out"):
        require_band(block, 16, 2)
    require_band(block, 16, 2, each_run=True)
    with pytest.raises(InputError, match="each_run must be left out"):
        require_band(Scene(**tables["needle"]), 16, None, each_run=True)


def test_a_file_of_fitted_constants_narrows_the_band_and_groups_what_it_correlates(
    block, wide, tmp_path
):
    values = {
        name: one.value
        for name, one in constants("cutting", "bone").items()
        if "chip" in name or "edge" in name
    }
    entries = "".join(
        f"[cutting.bone.{name}]\nvalue = {value}\nrange = [{0.95 * value}, {1.05 * value}]\n"
        'source = "a fit"\nconfidence = "H"\n'
        for name, value in values.items()
    )
    names = '["cutting.bone.radial_edge_N_mm", "cutting.bone.tangential_edge_N_mm"]'
    file = tmp_path / "fitted.toml"
    file.write_text(
        f"{entries}[correlation]\nnames = {names}\nmatrix = [[1.0, 0.8], [0.8, 1.0]]\n", "utf-8"
    )
    fitted = band_of(changed(block, {"materials": str(file)}), 16, cores=1)
    spread = [
        each.summary["force_N"]["peak"]["p95"] / each.summary["force_N"]["peak"]["p05"]
        for each in (wide, fitted)
    ]
    assert spread[1] < 0.4 * spread[0]
    groups = list(fitted.summary["sobol"]["force_N.peak"])
    assert "cutting.bone.tangential_edge_N_mm + cutting.bone.radial_edge_N_mm" in groups


@pytest.mark.parametrize(
    ("explained", "reason"), [({"force_N.peak": -0.05}, "explains only 0 %"), ({}, "does not vary")]
)
def test_missing_indices_are_reported_with_the_reason(explained, reason):
    band = {"asked": 16, "samples": 16, "how": "every sample was run", "sobol": {}, "problems": {}}
    line = next(band_lines(band | {"surrogate_explains": explained}))
    assert "no Sobol indices of the peak force, because" in line and reason in line
