"""Environments for learning: contract, seeds, scores of known policies, vectors."""

import pickle
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import tissue.environments
from meshes.base.errors import InputError
from tissue.fitting.fit_files import write_fitted
from tissue.materials.constants import Constant, constants

NAMES = ["tissue/Drilling-v0", "tissue/Milling-v0", "tissue/Palpation-v0"]


@pytest.fixture(scope="module", params=NAMES)
def env(request):
    made = gymnasium.make(request.param)
    yield made
    made.close()


def test_the_contract_of_gymnasium_is_kept(env):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped)


def test_the_same_seed_and_actions_give_the_same_episode_bit_for_bit(env):
    env.action_space.seed(3)
    towards = 1.0 if env.spec.id == "tissue/Drilling-v0" else -1.0
    actions = [env.action_space.sample() for _ in range(20)]
    for action in actions:
        action[-1] = towards * abs(action[-1])

    def run(seed):
        found = [env.reset(seed=seed)[0]]
        return np.array(found + [env.step(action)[0] for action in actions])

    first, other, again = run(5), run(6), run(5)
    assert np.array_equal(first, again) and not np.array_equal(first, other)


def test_a_restored_episode_continues_bit_for_bit(env):
    inner = env.unwrapped
    env.action_space.seed(4)
    actions = [env.action_space.sample() for _ in range(20)]
    for action in actions:
        action[-1] = abs(action[-1]) if env.spec.id == "tissue/Drilling-v0" else -abs(action[-1])

    def run(some):
        found = []
        for action in some:
            observation, reward, *_, info = inner.step(action)
            found.append([*observation, reward, info["score"], info["peak_force_N"]])
        return np.array(found)

    inner.reset(seed=8)
    run(actions[:10])
    sent = pickle.dumps(inner.snapshot())
    after = run(actions[10:])
    drawn = inner.reset()[1]["drawn"]
    inner.restore(pickle.loads(sent))
    assert np.array_equal(run(actions[10:]), after)
    assert inner.reset()[1]["drawn"] == drawn


def test_a_reward_is_the_sum_of_its_terms_and_doing_nothing_scores_what_is_documented(env):
    env.reset(seed=0)
    terms = {}
    over = False
    while not over:
        _, reward, terminated, truncated, info = env.step(
            np.zeros(env.action_space.shape, dtype=np.float32)
        )
        assert reward == pytest.approx(sum(info["reward_terms"].values()), abs=1e-12)
        terms = {name: terms.get(name, 0.0) + value for name, value in info["reward_terms"].items()}
        over = terminated or truncated
    assert truncated and info["score"] == pytest.approx(-0.1, abs=1e-9)
    assert sum(terms.values()) == pytest.approx(info["score"], abs=1e-9)


def test_an_option_fixes_what_would_be_drawn_and_leaves_the_rest(env):
    name, (low, high) = next(iter(env.unwrapped.ranges.items()))
    free, fixed = (
        env.reset(seed=1, options=options)[1]["drawn"]
        for options in (None, {name: 0.5 * (low + high)})
    )
    assert fixed == free | {name: 0.5 * (low + high)}
    for options, word in (({"nothing": 1.0}, "nothing"), ({name: high + 1.0}, name)):
        with pytest.raises(InputError, match=word):
            env.reset(options=options)


def test_an_action_of_another_shape_is_refused_with_the_shape(env):
    env.reset(seed=0)
    count = env.action_space.shape[0]
    for action, got in (
        (np.zeros(count + 1), rf"got an array of shape \({count + 1},\)"),
        ("up", "another type"),
    ):
        with pytest.raises(
            InputError, match=rf"action must be an array of shape \({count},\).*{got}"
        ):
            env.unwrapped.step(action)


def test_constants_of_a_file_hold_in_an_environment_and_others_are_refused(tmp_path):
    """Forces are proportional to the coefficients."""
    file, cited = tmp_path / "fitted.toml", constants("cutting", "bone")
    twice = {
        f"cutting.bone.{name}": 2.0 * one.value
        for name, one in cited.items()
        if name.endswith(("_N_mm", "_N_mm2"))
    }
    entries = {name: Constant(value, value, value, "a test", "L") for name, value in twice.items()}
    write_fitted(file, entries, np.eye(len(entries)))
    forces = []
    for given in (None, file):
        made = tissue.environments.Milling(materials=given)
        made.reset(seed=0)
        for _ in range(8):
            made.step([1.0, 0.0, -1.0])
        forces.append(made.mean_force_N)
    assert np.linalg.norm(forces[0]) > 1.0
    np.testing.assert_allclose(forces[1], 2.0 * forces[0], rtol=1e-6)
    modulus = Constant(5.0, 5.0, 5.0, "a test", "L")
    write_fitted(file, {"soft.liver.modulus_kPa": modulus}, np.eye(1))
    with pytest.raises(InputError, match="must contain a constant that the environment uses"):
        tissue.environments.Drilling(materials=file).reset(seed=0)
    with pytest.raises(TypeError, match="materials"):
        tissue.environments.Palpation(materials=file)


def test_a_bur_that_comes_back_into_its_cut_meets_nothing():
    env = gymnasium.make("tissue/Drilling-v0").unwrapped
    env.reset(seed=0)
    for _ in range(30):
        deepest = env.step([0.6])[4]["deepest_mm"]
    forces = [env.step([thrust])[4]["peak_force_N"] for thrust in (-1.0, -1.0, -1.0, 0.2)]
    # Measured: zero while the bur is pulled out, 4e-5 N at its return, and 1.3 N before.
    assert deepest > 0.3 and max(forces[1:3]) == 0.0 and forces[3] < 1e-4


def test_a_pushed_bur_balances_thrust_inertia_damping_and_the_force_of_the_same_tick():
    """A pushed bur balances thrust, inertia, damping and the force of the same tick.

    With 0.1 kg, 3 N and a damping that lets 3 N move it at 10 mm/s, m (v - v_before) / dt + 300 v +
    F = 3 N on its path down.
    """
    env = gymnasium.make("tissue/Drilling-v0").unwrapped
    env.reset(seed=3)
    off, forces = [], []
    for _ in range(250):
        before = env._speed
        force = float(env._tick(np.array([1.0]), 1)[2])
        if 0.0 < env._speed < 0.01:
            off.append(0.1 * (env._speed - before) / 1e-3 + 300.0 * env._speed + force - 3.0)
        forces.append(force)
    assert max(forces) > 1.5
    assert np.abs(off).max() < 0.01


def test_a_palpated_slab_answers_in_proportion_to_its_modulus_however_it_is_turned():
    env = gymnasium.make("tissue/Palpation-v0").unwrapped
    fixed = {"distance_mm": 18.0, "bearing_deg": 90.0}
    forces = {}
    for modulus, turn in ((3.0, 0.0), (6.0, 0.0), (3.0, 180.0)):
        env.reset(options=fixed | {"modulus_kPa": modulus, "turn_deg": turn})
        for _ in range(4):
            env.step([0.0, 0.0, -1.0])
        forces[modulus, turn] = env.mean_force_N
    assert forces[3.0, 0.0][2] > 0.01
    assert forces[6.0, 0.0] == pytest.approx(2.0 * forces[3.0, 0.0], rel=1e-9)
    # the mesh is not symmetric
    assert forces[3.0, 180.0][2] == pytest.approx(forces[3.0, 0.0][2], rel=0.1)


def test_environments_in_one_process_do_not_touch_each_other():
    first, second = (gymnasium.make("tissue/Palpation-v0") for _ in range(2))
    first.reset(seed=1)
    alone = [first.step(np.array([0.1, 0.0, -1.0], dtype=np.float32))[0] for _ in range(3)]
    first.reset(seed=1)
    second.reset(seed=2)
    mixed = []
    for _ in range(3):
        mixed.append(first.step(np.array([0.1, 0.0, -1.0], dtype=np.float32))[0])
        second.step(np.array([-0.5, 0.3, -1.0], dtype=np.float32))
    assert np.array_equal(alone, mixed)


def test_an_environment_is_made_by_a_name_that_imports_its_module(monkeypatch):
    monkeypatch.delitem(sys.modules, "tissue.environments")
    for name in NAMES:
        monkeypatch.delitem(gymnasium.registry, name)
    made = gymnasium.make(f"tissue.environments:{NAMES[1]}")
    assert made.spec.id == NAMES[1] and set(NAMES) <= set(gymnasium.registry)
