"""Random presses under hyperelastic laws: none may end in a traceback.

`tests/bench/bench_random_presses.py` carries out a thousand of them.
"""

from collections import Counter

import numpy as np
import pytest
from random_presses import draw, run_press

SEED = 42
PRESSES = 6


def test_linear_cells_press_without_a_traceback():
    """Two presses on linear cells, one of a scene and one of an organ, end with a force."""
    rng = np.random.default_rng(SEED)
    wanted = {"scene", "organ"}
    while wanted:
        press = draw(rng)
        kind = "scene" if press.shape in ("slab", "liver") else "organ"
        if kind not in wanted or press.material["order"] == 2:
            continue
        wanted.remove(kind)
        outcome = run_press(press)
        assert outcome.kind in ("converged", "contact"), outcome.why
        assert outcome.force_N > 0.0


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_random_presses_converge_or_state_a_reason(capsys):
    """No press fails, and at most one of six is refused or leaves a law unbalanced."""
    counts: Counter[str] = Counter()
    for seed in np.random.SeedSequence(SEED).spawn(PRESSES):
        press = draw(np.random.default_rng(seed))
        outcome = run_press(press)
        counts[outcome.kind] += 1
        assert outcome.kind != "failed", f"{press}\n{outcome.why}"
    with capsys.disabled():
        print(f"\n{dict(counts)}")
    assert counts["law"] + counts["refused"] <= 1
