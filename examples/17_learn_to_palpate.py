"""
Learn to palpate
================

The cross-entropy method finds the four parameters of a policy for `tissue/Palpation-v0`:

- the depth of the press,
- the distance from the start,
- the speed of sliding along the circle,
- the radial range of motion at the place with the largest force.

Needs ``pip install ".[rl]"``.
"""

from pathlib import Path
from typing import Any

import gymnasium
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
FIGURES = Path("figures")
FIGURES.mkdir(exist_ok=True)
TIP_MM = 22.0
FORCE_N = 1.0
TOP_MM_S = np.array([60.0, 60.0, 30.0])
"""Scales of the observation and the action, as ``env.unwrapped.entries`` states them."""
STEP_S = 0.02
LOW = np.array([-2.5, 4.0, 5.0, 0.0])
HIGH = np.array([-0.3, 20.0, 60.0, 0.9])
"""Bounds of the tip's height [mm], the radius [mm], the speed [mm/s] and the radial share.
"""

# %%
# The policy slides along a circle. It then moves outward and inward where the resistance was
# largest, and lifts at the hardest place. The policy uses only the observation. The resistance of a
# place is the force divided by the depth to the power of 3/2, which is constant in Hertz contact of
# a ball.


def hardest(felt: list[Floats]) -> Floats:
    """Return the weighted mean position of the hardest quarter of the touched places [mm]."""
    x, y, hard = np.array(felt).T
    # only the hardest quarter counts; 1e-12 avoids a division by zero if all places are equal
    weight = np.clip(hard - np.quantile(hard, 0.75), 0.0, None) ** 2 + 1e-12
    return np.array([weight @ x, weight @ y]) / weight.sum()


def score(env: Any, policy: Floats, seed: int) -> float:
    """Return the score of an episode under a policy (height, radius, speed, radial share)."""
    height, radius, speed, share = np.clip(policy, LOW, HIGH)
    observation, _ = env.reset(seed=seed)
    # corners at steps of 15 degrees, back to the first corner
    turns = np.linspace(0.0, 2.0 * np.pi, 25)
    plan = [radius * np.array([np.cos(turn), np.sin(turn)]) for turn in turns]
    felt: list[Floats] = []
    stage = 0
    over = False
    info = {"score": 0.0}
    while not over:
        tip = TIP_MM * observation[:3].astype(float)
        # entries 0 to 2 are the tip, 3 to 5 its velocity, 6 to 8 the force
        force = FORCE_N * float(np.linalg.norm(observation[6:9]))
        # while the tip moves outward, it has not reached its depth yet
        if np.hypot(*tip[:2]) > 0.5 * radius:
            # at depths below 0.3 mm, force and depth are too small to compute the resistance
            felt.append(np.array([*tip[:2], force / max(-tip[2], 0.3) ** 1.5]))
        # a corner counts as reached within 0.5 mm: a step at 60 mm/s is 1.2 mm long
        while plan and np.hypot(*(plan[0] - tip[:2])) < 0.5:
            plan.pop(0)
        # stage 1: cross the hardest place of the circle; stage 2: go to the hardest place there
        if not plan and stage < 2 and felt:
            place, stage = hardest(felt), stage + 1
            felt = felt if stage == 2 else []
            plan = [place] if stage == 2 else [place, (1.0 - share) * place, (1.0 + share) * place]
        away = (plan[0] if plan else tip[:2]) - tip[:2]
        aside = away / max(float(np.hypot(*away)), speed * STEP_S) * speed
        # without further corners, the tip rises at full speed above the 3 mm that count as lifted
        rise = (height if plan else 10.0) - tip[2]
        action = np.array([*aside, rise / STEP_S]) / TOP_MM_S
        observation, _, terminated, truncated, info = env.step(np.clip(action, -1.0, 1.0))
        over = terminated or truncated
    return float(info["score"])


# %%
# The cross-entropy method (Rubinstein 1999): draw policies from a normal distribution, keep the
# best quarter of the policies, and fit the distribution to this quarter. All policies of a
# generation are scored on the same new episodes.


def learn(
    env: Any, rng: np.random.Generator, *, generations: int = 5, count: int = 16, episodes: int = 3
) -> Floats:
    """Return mean and spread of the policies in each generation, shape (generations + 1, 2, 4)."""
    # a first guess that presses too lightly (score 0.12), with a spread of a third of the bounds
    mean = np.array([-0.6, 7.0, 15.0, 0.1])
    spread = 0.3 * (HIGH - LOW)
    history = [np.array([mean, spread])]
    for generation in range(generations):
        # height, radius, speed and share, see `score`
        policies = rng.normal(mean, spread, (count, 4))
        # seeds for learning start at 1000, seeds of the unseen episodes start at 0
        seeds = 1000 + generation * episodes + np.arange(episodes)
        scores = [np.mean([score(env, policy, int(seed)) for seed in seeds]) for policy in policies]
        best = np.clip(policies[np.argsort(scores)[-count // 4 :]], LOW, HIGH)
        mean = best.mean(axis=0)
        # add a spread of 2 % of the bounds, because a few best policies may agree by chance
        spread = best.std(axis=0) + 0.02 * (HIGH - LOW)
        history.append(np.array([mean, spread]))
    return np.array(history)


# %%
# Compute the scores of twenty episodes that were not used for learning: with the first guess, after
# each generation, and with random actions. The name starts with the module, so that gymnasium
# imports the module that registers it.

env = gymnasium.make("tissue.environments:tissue/Palpation-v0")
history = learn(env, np.random.default_rng(0))
unseen = np.array([[score(env, mean, seed) for seed in range(20)] for mean, _ in history])
for (height, radius, speed, share), scores in zip(history[:, 0], unseen, strict=True):
    policy = (
        f"height {height:5.2f} mm, radius {radius:4.1f} mm, {speed:4.1f} mm/s, share {share:.2f}"
    )
    print(f"{policy}: score {scores.mean():.2f} ({scores.min():.2f} to {scores.max():.2f})")
assert unseen[0].mean() < 0.3 and unseen[-1].mean() > 0.7

figure, axes = plt.subplots(figsize=(7, 4.2), layout="constrained")
axes.fill_between(
    np.arange(len(unseen)), unseen.min(axis=1), unseen.max(axis=1), color="#0072B2", alpha=0.2
)
axes.plot(unseen.mean(axis=1), "-o", color="#0072B2", label="mean and range of 20 unseen episodes")
axes.axhline(1.0, color="0.3", linestyle="--", linewidth=1.0, label="largest possible score")
axes.set(
    xlabel="generation of 16 policies, 3 episodes each", ylabel="score", xticks=range(len(unseen))
)
axes.grid(alpha=0.3)
axes.legend(loc="lower right")
figure.savefig(FIGURES / "17_learning.png", dpi=150)
