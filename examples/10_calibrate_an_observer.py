"""How well do 120 comparisons and 24 numbers measure what a person feels?

Expected: a simulated person with a Weber fraction of 7 % and Stevens' exponent 1.7 is found at 7.7 % and 1.71, with the
truth in both 95 % intervals; the session that is cut off after 50 trials and gone on with from its log ends with the
same observer, bit for bit. Over 200 such people one session is off by about 15 %, which is what 120 answers can show:
the answer to a comparison is one bit.
Run: python examples/10_calibrate_an_observer.py [--out FILE.png]
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from tissue.evaluation.calibration.posterior_view import draw_session
from tissue.evaluation.calibration.run_session import simulated_answers
from tissue.evaluation.calibration.session import Plan, Session
from tissue.evaluation.calibration.simulated_observer import SimulatedObservers
from tissue.evaluation.calibration.trial_log import TrialLog
from tissue.perception.adaptive import AdaptiveThreshold

WEBER, EXPONENT, PEOPLE = 0.07, 1.7, 200


def people(count: int) -> SimulatedObservers:
    """People of the same known truth."""
    truth = {"alpha": 1.0, "beta": EXPONENT, "kappa": WEBER, "offset_N": 0.2, "lapse": 0.02, "sigma": 0.2}
    return SimulatedObservers(**{name: np.full(count, value) for name, value in truth.items()})


def session(folder: Path, stop_after: int | None = None) -> Session:
    """A session, gone on with where the log in a folder ends, up to its end or a number of trials."""
    log = TrialLog(folder / "one.trials.jsonl", "seven percent", Plan())
    answer = simulated_answers(people(1), seed=1)
    while not log.session.complete and log.session.trial != stop_after:
        asked = log.session.ask()
        log.take(asked, answer(asked, log.session.trial))
    log.close()
    return log.session


def scatter() -> float:
    """Scatter of the Weber fraction over people of the same truth: standard deviation of its logarithm."""
    crowd, rng = people(PEOPLE), np.random.default_rng(0)
    found = AdaptiveThreshold(observers=PEOPLE)
    for _ in range(Plan().trials):
        asked = found.propose()
        found.answer(asked, crowd.correct(found.base_N[asked], found.step_N[asked], rng))
    return float(np.log(found.weber()[0] / WEBER).std())


def main(out: Path | None = None) -> None:
    with tempfile.TemporaryDirectory() as straight, tempfile.TemporaryDirectory() as cut:
        done = session(Path(straight))
        session(Path(cut), stop_after=50)
        again = session(Path(cut))
    for line in done.lines():
        print(line)
    low, high = done.threshold.weber_quantiles(np.array([0.025, 0.975]))[:, 0]
    least, most = done.magnitudes().exponent_at([0.025, 0.975])
    spread = scatter()
    print(f"scatter of the Weber fraction over {PEOPLE} people: {100 * spread:.0f} %")
    assert low < WEBER < high and least < EXPONENT < most
    assert (
        abs(done.threshold.weber()[0][0] / WEBER - 1.0) < 0.35 and abs(done.magnitudes().mean[1] / EXPONENT - 1.0) < 0.1
    )
    assert (again.observer("a").mean == done.observer("a").mean).all()
    assert 0.12 < spread < 0.19
    if out is not None:
        draw_session(done, out)
        print("picture in", out)


if __name__ == "__main__":
    main(Path(sys.argv[2]) if sys.argv[1:2] == ["--out"] else None)
