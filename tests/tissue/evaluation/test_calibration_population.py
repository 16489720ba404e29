"""Population from many sessions: the hierarchy, its convergence check, and refusals."""

import numpy as np
import pytest

from tissue.evaluation.calibration.answers import simulated_answers, simulated_observer
from tissue.evaluation.calibration.observers import draw_observers
from tissue.evaluation.calibration.population_fit import new_person
from tissue.evaluation.calibration.session import Plan, TrialLog
from tissue.perception.adaptive import MAGNITUDE_FORCES_N
from tissue.perception.hierarchy import HYPER, PopulationFit, PopulationTrials, fit_hierarchy
from tissue.perception.observer import read_observer


def sessions(folder, count, **plan):
    """Logs of simulated people."""
    found = []
    for seed in range(count):
        log = TrialLog(
            folder / f"{seed}.trials.jsonl", f"simulated:{seed}", Plan(seed=seed, **plan)
        )
        answer = simulated_answers(simulated_observer(f"simulated:{seed}")[0], seed)
        while not log.session.complete:
            asked = log.session.ask()
            log.take(asked, answer(asked, log.session.trial))
        log.close()
        found.append(log.session)
    return found


def a_fit(**changes):
    """Draws of a population that is known."""
    rng, shape = np.random.default_rng(0), (2, 500)
    middle = {
        "log_alpha": 0.0,
        "beta": 1.7,
        "variance": 0.04,
        "log_kappa": np.log(0.08),
        "log_offset": np.log(0.2),
    }
    draws = {name: middle.get(name, 0.2) + 0.01 * rng.standard_normal(shape) for name in HYPER}
    draws["lapse"] = rng.uniform(0.01, 0.03, (*shape, 4))
    given = {
        "draws": draws,
        "r_hat": dict.fromkeys(HYPER, 1.0),
        "ess": dict.fromkeys(HYPER, 900.0),
        "divergences": 0,
    }
    return PopulationFit(**(given | changes))


def test_a_new_person_scatters_as_people_do():
    """Medians and spreads of the draws' population, to five standard errors of a thousand draws."""
    person = new_person(a_fit(), trials=7, rng=np.random.default_rng(1))
    assert person.trials == 7 and person.kappa == pytest.approx(0.08, rel=0.04)
    assert person.beta == pytest.approx(1.7, abs=0.04)
    assert person.covariance[1, 1] ** 0.5 == pytest.approx(0.2, rel=0.15)


@pytest.mark.slow
def test_a_population_is_recovered(tmp_path):
    """A population is recovered from six people of 60 comparisons and 12 numbers.

    The truth lies in the 99.8 % intervals of the population's means.
    """
    pytest.importorskip("numpyro", reason="the extra perception is not installed")
    rng, count = np.random.default_rng(0), 6
    crowd = draw_observers("intermediate", count, rng)
    base, step = np.tile([0.3, 0.8, 2.0], 20), np.repeat(np.geomspace(0.05, 0.4, 20), 3)
    right = np.array([crowd.correct(b, s, rng) for b, s in zip(base, step, strict=True)])
    forces = np.resize(MAGNITUDE_FORCES_N, 12)
    numbers = np.array([crowd.number(force, rng) for force in forces])
    everyone = np.arange(count)
    fit = fit_hierarchy(
        PopulationTrials(
            count,
            np.column_stack(
                [
                    np.tile(everyone, 60),
                    np.repeat(base, count),
                    np.repeat(step, count),
                    right.ravel(),
                ]
            ),
            np.column_stack([np.tile(everyone, 12), np.repeat(forces, count), numbers.ravel()]),
        ),
        warm_up=120,
        draws=120,
    )
    truth = {
        "beta": crowd.beta.mean(),
        "log_alpha": np.log(crowd.alpha).mean(),
        "log_kappa": np.log(crowd.kappa).mean(),
    }
    for name, value in truth.items():
        low, high = np.quantile(fit.draws[name], [0.001, 0.999])
        assert low < value < high, name
    assert set(fit.r_hat) == set(fit.ess) == {*HYPER, "people"} and max(fit.r_hat.values()) < 1.15
    assert (fit.draws["kappa"] > 0.0).all() and fit.draws["kappa"].shape == (2, 120, count)


def test_the_command_writes_a_population(command, here, monkeypatch):
    """With a fit that is known, which costs a minute to draw."""
    (here / "people").mkdir()
    sessions(here / "people", 4, trials=10, numbers=6)
    monkeypatch.setattr(
        "tissue.evaluation.calibration.population_fit.fit_hierarchy",
        lambda trials, seed, progress: a_fit(divergences=2),
    )
    code, out, _ = command("calibrate", "--population", "people", "--out", "all.json")
    assert code == 0 and "4 observers" in out and "R-hat at most 1.000" in out
    assert "2 divergences" in out and "note: 2 transitions diverged" in out
    assert read_observer(here / "all.json").trials == 4 * 16
    assert (
        (here / "all.table.csv")
        .read_text()
        .startswith("parameter,low_95,median,high_95,r_hat,ess\nlog_alpha,")
    )
    code, _, error = command("calibrate", "--population", "people", "--out", "all.json")
    assert code == 2 and "out must not exist yet" in error
