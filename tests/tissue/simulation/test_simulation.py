"""`simulate`: the output filter, what is recorded, and what is left alone."""

import numpy as np
import pytest
from scipy.signal import lfilter

from tissue import InputError, load_scene, simulate
from tissue.simulation.simulate import TICK_S

COARSE = {"voxels.spacing_mm": 0.4, "duration_s": 0.2}
AXES = [("force", "N"), ("torque", "Nm")]


def run_of(name="milling", **changes):
    return simulate(
        load_scene(name, COARSE | {key.replace("__", "."): value for key, value in changes.items()})
    )


@pytest.fixture(scope="module")
def run():
    return run_of(output__low_pass_ms=5.0)


def test_a_coefficient_without_effect_is_refused_with_its_value():
    with pytest.raises(
        InputError, match=r"^cutting.density_exponent must be left out .*\. Set another"
    ):
        run_of(cutting__density_exponent=1.5)


@pytest.mark.parametrize(("name", "unit"), AXES)
def test_the_commanded_force_is_the_exact_low_pass_of_the_models(run, name, unit):
    """y += (1 - exp(-T/a)) (u - y), the zero-order-hold discretisation of 1 / (1 + a s)."""
    model, commanded = run.trace.vectors(f"model_{name}", unit), run.trace.vectors(name, unit)
    keep = np.exp(-TICK_S / 5e-3)
    assert np.abs(model).max() > 0.0
    np.testing.assert_allclose(
        commanded, lfilter([1.0 - keep], [1.0, -keep], model, axis=0), rtol=1e-10, atol=1e-15
    )


@pytest.mark.parametrize(("duration_s", "ticks"), [(0.001, 1), (0.0123, 12), (0.2, 200)])
def test_a_row_a_tick(duration_s, ticks):
    run = run_of(duration_s=duration_s)
    assert run.trace.rows.shape == (ticks, len(run.trace.columns))
    assert run.timing.rows.shape == (ticks, len(run.timing.columns))
    np.testing.assert_allclose(run.trace["time_s"], TICK_S * np.arange(ticks), rtol=1e-15)
    assert np.isfinite(run.trace.rows).all()
    assert run.summary["simulated_s"] == pytest.approx(ticks * TICK_S)


def test_the_removed_volume_is_that_of_the_layers_and_never_falls():
    run = run_of("glenoid", motion__feed_mm_s=10.0)
    layers = sum(run.trace[f"removed_{name}_mm3"] for name in run.trace.layer_names)
    np.testing.assert_allclose(run.trace["removed_mm3"], layers, rtol=1e-12)
    assert (np.diff(run.trace["removed_mm3"]) >= 0.0).all() and run.trace["removed_mm3"][-1] > 0.0
    touching = run.trace["contact_mm2"] > 0.0
    assert ((run.trace["layer"] == "none") == ~touching).all()
    in_air = run.trace.vectors("model_force", "N")[~touching]
    assert not in_air.any()
