"""Cost of a fit and of learning on: `python tests/bench/bench_edmd.py [--quick]`.

1. A fit of 100,000 samples of six states and three inputs, by number of observables, beside pykoop on the same data
   where it is installed: seconds, the better of two.
2. Lifting one state, advancing it, and one recursive update, a call each.
"""

import argparse
from time import perf_counter

import numpy as np
from harness import cost_of, machine, table

from tissue.prediction.edmd.dictionary import Delays, Gaussians, Identity, Polynomials
from tissue.prediction.edmd.edmd import Edmd
from tissue.prediction.edmd.episodes import Episode
from tissue.prediction.edmd.online import Online

STATES, INPUTS, ROWS, STEP_S = 6, 3, 1000, 1e-3


def recorded(count: int) -> list[Episode]:
    """Episodes of a noisy stable system, a second each."""
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(STATES, STATES)))[0] * 0.99
    push = 0.1 * rng.normal(size=(STATES, INPUTS))
    states, inputs = np.zeros((count, ROWS + 1, STATES)), rng.normal(size=(count, ROWS + 1, INPUTS))
    for k in range(ROWS):
        noise = 0.1 * rng.normal(size=(count, STATES))
        states[:, k + 1] = states[:, k] @ turn.T + inputs[:, k] @ push.T + noise
    return [Episode(x, u, STEP_S) for x, u in zip(states, inputs, strict=True)]


def seconds(call) -> float:
    """The better of two."""
    took = []
    for _ in range(2):
        start = perf_counter()
        call()
        took.append(perf_counter() - start)
    return min(took)


def by_pykoop(episodes: list[Episode]) -> str:
    """Time of pykoop's fit with polynomials of second order."""
    try:
        import pykoop
    except ImportError:
        return "not installed"
    rows = [np.hstack((np.full((ROWS + 1, 1), i), e.states, e.inputs)) for i, e in enumerate(episodes)]
    data = np.vstack(rows)
    lifting = [("it", pykoop.SplitPipeline(lifting_functions_state=[("of", pykoop.PolynomialLiftingFn(order=2))]))]
    pipeline = pykoop.KoopmanPipeline(lifting_functions=lifting, regressor=pykoop.Edmd())
    return f"{seconds(lambda: pipeline.fit(data, n_inputs=INPUTS, episode_feature=True)):.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a tenth of the data")
    quick = parser.parse_args().quick
    episodes = recorded(10 if quick else 100)
    states = np.vstack([each.states for each in episodes])
    rng = np.random.default_rng(1)
    dictionaries = {
        "identity": Identity(),
        "second order": Polynomials(2),
        "ten delays": Delays(10),
        "100 Gaussians": Gaussians.from_states(states, 100, rng),
    }
    print(machine(), f"\n{len(episodes) * ROWS} samples\n")
    fits, calls = [], []
    for name, dictionary in dictionaries.items():
        edmd = Edmd(dictionary, ridge=1e-8)
        peer = by_pykoop(episodes) if name == "second order" else ""
        operator = edmd.fit(episodes)
        fits.append((name, str(len(operator.offset)), f"{seconds(lambda e=edmd: e.fit(episodes)):.2f}", peer))
        online, window = Online(operator), episodes[0].states[: dictionary.lags + 1][::-1].ravel()
        lifted, push = dictionary.lift(window), episodes[0].inputs[0]
        costs = (
            cost_of(lambda _, d=dictionary, w=window: d.lift(w), count=2000),
            cost_of(lambda _, o=operator, z=lifted, u=push: o.advance(z, u), count=2000),
            cost_of(lambda _, o=online, z=lifted, u=push: o.update(z, u, z), count=2000),
        )
        calls.append((name, *(f"{each.median:.1f} / {each.p99:.1f}" for each in costs)))
    print(table(fits, ("dictionary", "observables", "fit s", "pykoop s")), "\n")
    print(table(calls, ("median / 99 % us", "lift", "advance", "update")))


if __name__ == "__main__":
    main()
