"""Predictors that the documentation and the example of a plugin show."""

import re
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[3]
SOURCES = {
    "FadingSlope": "docs/guide/predictor.md",
    "Straight": "docs/extending.md",
    "Slope": "examples/16_your_device_and_predictor.py",
    "DampedLine": "examples/plugin/tissue_toys/predictor.py",
}


def shown_class(name):
    """Return the class of a page or file, without the decorator that registers the class."""
    text = (ROOT / SOURCES[name]).read_text("utf-8")
    source = re.search(rf"(?m)^class {name}:\n(?:(?: .*)?\n)+", text).group(0)
    names = {"np": np, "Floats": np.ndarray, "FADE": 0.9}
    exec(source, names)
    return names[name]


@pytest.mark.parametrize("name", SOURCES)
@pytest.mark.parametrize("model_ticks", [1, 10])
def test_a_ramp_is_continued_with_its_slope_for_any_interval_of_the_model(name, model_ticks):
    """A ramp of 0.02 N per tick, from a model that has a force in every tick or every tenth."""
    predictor = shown_class(name)()
    slope_N = np.array([0.0, 0.0, 0.02])
    rest = np.zeros(3)
    for tick in range(1, 201):
        predictor.observe(rest, rest, tick * slope_N if tick % model_ticks == 0 else None)
    # the slope was learnt over 200 ticks, from which 0.9**200 is negligible
    np.testing.assert_allclose(predictor.slope_N, slope_N, rtol=1e-6)
    np.testing.assert_allclose(predictor.predict(0), 200 * slope_N)
    predictor.observe(rest, rest, None)
    np.testing.assert_allclose(predictor.predict(0), 201 * slope_N, rtol=1e-3)
