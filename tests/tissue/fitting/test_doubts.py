"""Values and clocks that contradict their priors.

They are reported everywhere, and no result based on them is marked as determined.
"""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from planted_logs import planted, slot

from tissue.fitting.fit import SceneFit
from tissue.fitting.fit_files import write_fit
from tissue.fitting.identifiability import identified
from tissue.fitting.posterior import maximum_posterior

NAMES = ("radial_chip_N_mm2", "tangential_chip_N_mm2")


def coarse_slot():
    """A slot at a fifth of the samples, to save time."""
    whole = slot()
    return replace(whole, times_s=whole.times_s[::5], basis=whole.basis[::5])


def fitted(folder, *, forward=None, factor=1.0, offset_s=0.0):
    """Return a fit to a log of median constants.

    Its loads are scaled as by a wrong unit, and its clocks differ.
    """
    forward = forward or coarse_slot()
    log, _ = planted(
        forward,
        np.random.default_rng(5),
        z=np.zeros(4),
        offset_s=offset_s,
        bias=np.zeros(3),
        scale=0.02,
    )
    posterior = maximum_posterior(forward, replace(log, values=factor * log.values))
    path = folder / "log.csv"
    path.write_text("time_s\n", "utf-8")
    return SceneFit("slot", path, posterior, identified(posterior), (), 0.01, (), {})


def states(fit):
    return {each.name.rpartition(".")[2]: each.state for each in fit.constants}


def test_a_log_that_agrees_with_its_priors_has_no_doubts(tmp_path):
    fit = fitted(tmp_path)
    assert fit.doubts == () and set(states(fit).values()) == {"determined"}
    assert not any("doubtful" in each for each in fit.verdicts)


@pytest.mark.slow
def test_constants_a_thousand_times_too_small_are_doubtful(tmp_path):
    """Forces in kN read as N."""
    fit = fitted(tmp_path, factor=1e-3)
    found = {each.name.rpartition(".")[2]: each for each in fit.constants}
    for name in NAMES:
        assert found[name].state == "doubtful" and found[name].value < found[name].prior.low / 5.0
    write_fit(fit, tmp_path / "fit", overwrite=False)
    stated = [
        each for each in fit.verdicts if each.startswith("doubtful: ") and "tangential_chip" in each
    ]
    assert len(stated) == 1 and "below its range of 50 to 300" in stated[0]
    numbers = json.loads((tmp_path / "fit" / "fit.json").read_text("utf-8"))
    assert any("tangential_chip" in each for each in numbers["doubts"])
    entry = tomllib.loads((tmp_path / "fit" / "fitted.toml").read_text("utf-8"))["cutting"]["bone"][
        NAMES[0]
    ]
    assert entry["confidence"] == "L" and "doubtful" in entry["source"]
    assert "below its range" in (tmp_path / "fit" / "report.html").read_text("utf-8")


def test_clocks_that_contradict_their_prior_determine_nothing(tmp_path):
    fit = fitted(tmp_path, offset_s=0.15)
    assert fit.offset_sd == pytest.approx(7.5, abs=0.1)
    assert set(states(fit).values()) == {"doubtful"}
    assert "150 ms after the poses, 7.5 standard deviations" in fit.verdicts[0]


def test_a_fit_of_keys_of_the_scene_alone_is_saved(tmp_path):
    """`fitted.toml` holds constants of materials only, so it is not written."""
    forward = coarse_slot()
    keys = ("organ.friction", "organ.young_kPa", "organ.exponent", "organ.share")
    renamed = [replace(one, name=key) for one, key in zip(forward.parameters, keys, strict=True)]
    fit = fitted(tmp_path, forward=replace(forward, parameters=tuple(renamed)))
    assert tuple(fit.scene_keys) == keys and fit.of_material == ()
    write_fit(fit, tmp_path / "fit", overwrite=False)
    assert not (tmp_path / "fit" / "fitted.toml").exists()
    report = (tmp_path / "fit" / "report.html").read_text("utf-8")
    assert "fitted.toml" not in report and "<code>--set organ.friction=" in report
    numbers = json.loads((tmp_path / "fit" / "fit.json").read_text("utf-8"))
    assert [one["name"] for one in numbers["constants"]] == list(keys)
