"""Lines of figures that `tissue chart prediction` prints."""

import numpy as np
import pytest

from tissue.evaluation.charts.prediction import (
    OURS,
    Interval,
    PredictorComparison,
    comparison_lines,
)
from tissue.evaluation.training import HORIZONS
from tissue.scene.registry import PREDICTORS


def line_of(differences):
    """Return the sentence on runs of very different errors.

    Our errors are larger by `differences` than all others.
    """
    runs = np.geomspace(0.01, 0.5, len(differences))
    errors = {kind: np.tile(runs[:, None], len(HORIZONS)) for kind in PREDICTORS}
    errors[OURS] = errors[OURS] + np.array(differences)[:, None]
    empty, nothing = np.array([], dtype=complex), Interval(0.0, 0.0, 0.0)
    found = PredictorComparison(
        "wall", errors, dict.fromkeys(PREDICTORS, (1.0, 2.0)), empty, {1: nothing}, {}
    )
    return comparison_lines([found])[-1]


@pytest.mark.parametrize(
    ("differences", "verdict"),
    [
        ([-0.011, -0.009] * 4, "better than"),  # though the runs scatter fifty times as wide
        ([0.011, 0.009] * 4, "worse than"),
        ([-0.011, 0.005] * 4, "not distinct from"),  # mean -0.003, standard error 0.003
        ([-0.03, -0.001], "not distinct from"),  # both runs better, but two are too few
    ],
)
def test_one_predictor_is_better_only_where_pairs_of_runs_show_it(differences, verdict):
    assert f"{verdict} the best other, " in line_of(differences)


def test_the_interval_of_pairs_is_that_of_student():
    """The interval of pairs is Student's.

    Mean -1 %, standard deviation 0.1 %, three runs: 4.3027 is the 97.5 % quantile of t at two
    degrees of freedom.
    """
    half = 4.3027 * 0.1 / np.sqrt(3.0)
    assert f"-1.00 in pairs ({-1.0 - half:+.2f} to {-1.0 + half:+.2f})" in line_of(
        [-0.009, -0.010, -0.011]
    )
