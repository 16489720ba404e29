"""What a prediction costs: a tick of every predictor, a fit, and the same beside pykoop where it is installed.

Run: python tests/bench/bench_prediction.py [SCENE ...]
"""

import sys
from collections.abc import Callable
from time import perf_counter

import numpy as np
from harness import cost_of, machine, table

from tissue.builders.prediction import trained_predictor
from tissue.evaluation.training.recording import Recorder, Recording, trial
from tissue.prediction.edmd.edmd import Edmd
from tissue.prediction.edmd.online import Online
from tissue.prediction.predictor import Predictor
from tissue.prediction.trained import Trained, shipped_file
from tissue.scene.load import load_scene
from tissue.scene.registry import PREDICTORS

LEAD = 6
FIT_SAMPLES = 100_000


def measure(name: str) -> None:
    """All costs on a scene."""
    trained = Trained.read(shipped_file(name), scene=name)
    run = Recorder().record(trial(load_scene(name), 31_000, delay_ms=4))
    rows = []
    for kind in PREDICTORS:
        cost = cost_of(ticks_of(trained_predictor(kind, trained, force_limit_N=3.3), run), count=len(run.force_N))
        rows.append((kind, f"{cost.median:.1f}", f"{cost.p99:.1f}", f"{cost.worst:.1f}"))
    size, episode = len(trained.operator.offset), run.episode()
    print(f"\n{name}: observe and predict {LEAD} ticks ahead [us]; {size} observables, {len(run.force_N)} ticks")
    print(table(rows, ("predictor", "median", "99 %", "worst")))
    many = [episode] * (FIT_SAMPLES // len(episode.states) + 1)
    start = perf_counter()
    operator = Edmd(trained.operator.dictionary).fit(many)
    print(f"fit of {len(many) * len(episode.states)} samples: {perf_counter() - start:.2f} s")
    online, lags = Online(operator), operator.dictionary.lags
    windows = [operator.lift(episode.states[row - lags : row + 1]) for row in range(lags, lags + 400)]
    update = cost_of(lambda index: online.update(windows[index], None, windows[index + 1]), count=398)
    print(f"one online update: {update.median:.0f} us median, {update.p99:.0f} us 99 %, without new powers")
    _against_pykoop(episode.states[:3000], lags)


def ticks_of(predictor: Predictor, run: Recording) -> Callable[[int], object]:
    """One tick of a predictor on a recorded run."""

    def tick(index: int) -> object:
        predictor.observe(run.position_m[index], run.velocity_m_s[index], run.force_N[index])
        return predictor.predict(LEAD)

    return tick


def _against_pykoop(states: np.ndarray, lags: int) -> None:
    """A call of pykoop with the same delays."""
    try:
        import pykoop
    except ImportError:
        print("pykoop is not installed: not compared")
        return
    delays = pykoop.DelayLiftingFn(n_delays_state=lags, n_delays_input=0)
    model = pykoop.KoopmanPipeline(lifting_functions=[("delay", delays)], regressor=pykoop.Edmd(alpha=1e-8))
    table_ = np.hstack((np.zeros((len(states), 1)), states))
    model.fit(table_, n_inputs=0, episode_feature=True)
    cost = cost_of(lambda index: model.predict(table_[index : index + lags + 1]), count=120, warm_up=20)
    print(f"pykoop, one step with {lags} delays: {cost.median:.0f} us median, {cost.p99:.0f} us 99 %")


if __name__ == "__main__":
    print(machine())
    for scene in sys.argv[1:] or ["wall", "palpation", "milling"]:
        measure(scene)
