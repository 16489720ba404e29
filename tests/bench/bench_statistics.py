"""What the statistics of a study cost: populations a second, one fit, one regression beside its chains.

Run from the repository: PYTHONPATH=tests/fixtures python tests/bench/bench_statistics.py
"""

import numpy as np
from harness import cost_of, machine, table
from simulated_cells import simulated_cells, simulated_power

from tissue.evaluation.statistics.comparison import compare
from tissue.evaluation.statistics.components import Components, balanced_components, balanced_values
from tissue.evaluation.statistics.hpi import composite_index
from tissue.evaluation.statistics.mixed import mixed_model
from tissue.evaluation.statistics.power import redrawn_power
from tissue.evaluation.statistics.regression import trial_regression
from tissue.evaluation.statistics.strata import strata
from tissue.evaluation.statistics.trials import TrialTable

WORLD = Components(user=1.0, user_method=0.3, trial=0.5, residual=1.0)
MEANS = np.tile([0.0, 0.1, 0.2, 0.3], (3, 1))


def study(users: int = 10, trials: int = 10) -> TrialTable:
    """One task of a study of 900 trials: three groups, 100 trials each, four methods."""
    rng = np.random.default_rng(1)
    rows = []
    for group in ("expert", "intermediate", "novice"):
        for user in range(users):
            level, tastes = rng.normal(), 0.5 * rng.normal(size=4)
            for trial in range(trials):
                shared = 0.7 * rng.normal()
                for index, method in enumerate(("energy", "koopman", "penalty", "perception")):
                    value = level + tastes[index] + shared + rng.normal()
                    row = {"task": "wall", "group": group, "user": f"u{user}", "trial": trial, "method": method}
                    rows.append(row | {"seed": 0, "force_error": value, "latency_ms": 4.0 + 0.2 * value + rng.normal()})
    return TrialTable.from_rows(rows)


def main() -> None:
    print(machine())
    rng = np.random.default_rng(2)
    trials = study()
    cells = trials.cells("force_error")
    size = {"users_per_group": 10, "trials": 10}
    values, groups = simulated_cells(WORLD, MEANS, populations=10_000, rng=rng, **size)
    cases = {
        "test of methods, 10,000 populations": (lambda _: strata(values, groups, (4,), (0,), between=False), 10),
        "error rates of three tests, 10,000 simulated": (lambda _: simulated_power(WORLD, MEANS, rng=rng, **size), 5),
        "error rates of three tests, 10,000 redrawn": (lambda _: redrawn_power(cells, rng=rng), 5),
        "mixed model, 1,200 rows, by statsmodels": (lambda _: mixed_model(trials, "force_error"), 5),
        "the same variances in closed form": (
            lambda _: balanced_components(*balanced_values(trials, "force_error")),
            20,
        ),
        "all that is asked of one metric": (
            lambda _: compare(trials, "force_error", task="wall", rng=np.random.default_rng(3)),
            4,
        ),
        "regression, posterior by quadrature": (
            lambda _: trial_regression(trials, "force_error", ["latency_ms"]),
            20,
        ),
        "composite index, 2,000 redrawn": (
            lambda _: composite_index(trials, {"force_error": -1, "latency_ms": -1}, rng=rng),
            10,
        ),
    }
    rows = []
    for name, (call, count) in cases.items():
        cost = cost_of(call, count=count + 1, warm_up=1)
        rows.append((name, f"{1e-3 * cost.median:.1f}", f"{1e-3 * cost.worst:.1f}"))
    print(table(rows, ("what", "median ms", "worst ms")))
    fit, closed = (float(rows[index][1]) for index in (3, 4))
    print(f"closed form over fit: {fit / closed:.0f} times as fast")


if __name__ == "__main__":
    main()
