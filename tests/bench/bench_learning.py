"""Scores of learned, scripted and random palpation on 20 unseen episodes.

Run: `python tests/bench/bench_learning.py`.

The example learns by three generators of its policies. It takes some eight minutes.
"""

import sys
from pathlib import Path

import gymnasium
import numpy as np
from environment_experts import expert_of
from harness import machine

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "fixtures"))

from learning_example import functions

SEEDS = range(20)


def played(env, make_policy, seed):
    """Score of an episode."""
    seen, info = env.reset(seed=seed)
    policy, over = make_policy(), False
    while not over:
        seen, _, terminated, truncated, info = env.step(np.asarray(policy(seen), dtype=np.float32))
        over = terminated or truncated
    return info["score"]


def main() -> None:
    print(machine())
    example, env = functions(), gymnasium.make("tissue.environments:tissue/Palpation-v0")
    rng = np.random.default_rng(0)
    kinds = {
        "random": lambda: lambda seen: rng.uniform(-1.0, 1.0, 3),
        "expert": lambda: expert_of(env),
    }
    found = {name: [played(env, make, seed) for seed in SEEDS] for name, make in kinds.items()}
    for generator in range(3):
        history = example["learn"](env, np.random.default_rng(generator))
        found["first guess"] = [example["score"](env, history[0, 0], seed) for seed in SEEDS]
        found[f"learned, generator {generator}"] = [
            example["score"](env, history[-1, 0], seed) for seed in SEEDS
        ]
    for name, scores in found.items():
        print(f"{name:20s} {np.mean(scores):6.3f} ({min(scores):.3f} to {max(scores):.3f})")


if __name__ == "__main__":
    main()
