"""Example that learns to palpate. It scores better than at its start on unseen episodes."""

import gymnasium
import numpy as np
import pytest
from learning_example import functions


@pytest.mark.slow
@pytest.mark.parametrize("generator", [0, 1])
def test_two_generations_palpate_better_than_the_first_guess(generator):
    example, env = functions(), gymnasium.make("tissue.environments:tissue/Palpation-v0")
    history = example["learn"](env, np.random.default_rng(generator), generations=2)
    before, after = (
        [example["score"](env, mean, seed) for seed in range(6)] for mean in history[[0, -1], 0]
    )
    print(f"\n{np.mean(before):.2f} to {np.mean(after):.2f}")
    assert np.mean(after) > np.mean(before) + 0.2
