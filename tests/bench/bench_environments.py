"""Scores and throughput of the environments.

Run: `python tests/bench/bench_environments.py [--seeds 10] [--steps 200]`.

1. What the expert, random actions and none score, mean and range over seeds that set nothing (from
1000 on).
2. Steps a second of experts' first steps, and a second of processor time: one environment, and
vectors of 1 and 2
   processes, medians of five runs.
3. Share of an environment's time in carving and force (`advance` and `respond` of the model).
"""

import argparse
from statistics import median
from time import perf_counter, process_time

import gymnasium
import numpy as np
from environment_experts import expert_of
from harness import machine

import tissue.environments

NAMES = tuple(f"tissue/{name}-v0" for name in ("Milling", "Drilling", "Palpation"))
RUNS = 5


def scores(name: str, seeds: int) -> None:
    env = gymnasium.make(name)
    env.action_space.seed(0)
    for kind in ("expert", "random", "none"):
        found = []
        for seed in range(1000, 1000 + seeds):
            seen, info = env.reset(seed=seed)
            expert, over = expert_of(env), False
            while not over:
                action = (
                    np.zeros(env.action_space.shape)
                    if kind == "none"
                    else env.action_space.sample()
                )
                if kind == "expert":
                    action = expert(seen)
                seen, _, terminated, truncated, info = env.step(
                    np.asarray(action, dtype=np.float32)
                )
                over = terminated or truncated
            found.append(info["score"])
        print(
            f"  {kind:7s} {np.mean(found):6.3f} ({min(found):.3f} to {max(found):.3f})", flush=True
        )


def throughput(name: str, steps: int) -> None:
    env = gymnasium.make(name)
    seen, _ = env.reset(seed=0)
    expert, actions = expert_of(env), []
    for _ in range(50):  # enough to meet tissue, and fewer than an episode
        actions.append(np.asarray(expert(seen), dtype=np.float32))
        seen = env.step(actions[-1])[0]
    model = env.unwrapped.organ if "Palpation" in name else env.unwrapped.bone.model
    spent = [0.0]

    def timed(call):
        def run(*arguments):
            start = perf_counter()
            found = call(*arguments)
            spent[0] += perf_counter() - start
            return found

        return run

    def played(call, reset, many):
        begin = perf_counter()
        for index in range(steps):
            if index % 50 == 0:
                reset(seed=0)
            action = actions[index % 50]
            call(np.stack([action] * many) if many else action)
        return max(many, 1) * steps / (perf_counter() - begin)

    begin, rates = process_time(), [played(env.step, env.reset, 0) for _ in range(RUNS)]
    rate = RUNS * steps / (process_time() - begin)
    print(
        f"  one environment {median(rates):5.0f} steps/s, {rate:.0f} a second of processor time",
        flush=True,
    )
    model.advance, model.respond = timed(model.advance), timed(model.respond)
    begin = perf_counter()
    played(env.step, env.reset, 0)
    print(f"  of its time in the model {spent[0] / (perf_counter() - begin):.0%}")
    for many in (1, 2):
        vector = gymnasium.make_vec(name, num_envs=many, vectorization_mode="async")
        vector.reset(seed=0)
        rate = median(played(vector.step, vector.reset, many) for _ in range(RUNS))
        print(f"  {many} worker{'s' * (many > 1)} {rate:5.0f} steps/s", flush=True)
        vector.close()


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--steps", type=int, default=200)
    asked = parser.parse_args()
    print(machine(), tissue.environments.__name__)
    for name in NAMES:
        print(name)
        throughput(name, asked.steps)
        scores(name, asked.seeds)


if __name__ == "__main__":
    main()
