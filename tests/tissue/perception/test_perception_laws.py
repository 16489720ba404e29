"""Laws that hold for every choice of perception, tick by tick, and the command's bad inputs."""

import numpy as np
import pytest

from tissue import InputError
from tissue.haptics.loop.filters import ForceRange
from tissue.perception.observer import Observer, reference_observer, write_observer
from tissue.simulation.builders.prediction import perception

LIMIT_N, TICK = 3.3, 1e-3
OBSERVERS = {
    "reference": {"alpha": 1.0, "beta": 1.7},
    "weak": {"alpha": 0.6, "beta": 1.4, "spread": {"alpha": 0.1, "beta": 0.1, "kappa": 0.2}},
    "strong": {"alpha": 1.6, "beta": 2.0, "kappa": 0.04, "offset_N": 0.1},
    "dull": {"kappa": 0.25, "offset_N": 0.5},
}


def someone(name):
    given = {"alpha": 1.0, "beta": 1.7, "kappa": 0.07, "offset_N": 0.2, "lapse": 0.02, "sigma": 0.2}
    return Observer.known(name, **(given | OBSERVERS[name]))


@pytest.fixture(params=["population", *OBSERVERS])
def choice(request, tmp_path):
    if request.param == "population":
        return "population"
    write_observer(someone(request.param), tmp_path / "o.json")
    return f"observer:{tmp_path / 'o.json'}"


def built(choice, seed=0):
    return perception(choice, rng=np.random.default_rng(seed), force_limit_N=LIMIT_N, tick_s=TICK)


def forces(count=3000, seed=1):
    """Contacts that come, press, tremble, turn and go [N], shape (count, 3)."""
    rng = np.random.default_rng(seed)
    time = TICK * np.arange(count)
    size = np.maximum(1.2 * np.sin(2.0 * np.pi * 0.7 * time), 0.0) + 0.002 * rng.standard_normal(
        count
    )
    size[size < 0.0] = 0.0
    turn = 0.8 * np.sin(2.0 * np.pi * 0.3 * time)
    return size[:, None] * np.column_stack([np.sin(turn), 0.2 * np.cos(3.0 * turn), np.cos(turn)])


def played(person, sequence):
    return np.array([person.step(force).copy() for force in sequence])


def test_nothing_comes_of_nothing(choice):
    person = built(choice)
    assert not played(person, np.zeros((50, 3))).any()
    played(person, forces())
    assert not person.step(np.zeros(3)).any() and person.perceived == 0.0


def test_unrendered_changes_stay_below_the_threshold_and_no_bias_grows(choice):
    person, sequence = built(choice), forces()
    commands = played(person, sequence)
    size = np.linalg.norm(sequence, axis=1)
    wanted = sequence * (person.law.command_N(size) / np.maximum(size, 1e-300))[:, None]
    off = np.linalg.norm(commands - wanted, axis=1)
    kappa, least = person.deadband._kappa, person.deadband._least
    assert (off <= (kappa * np.linalg.norm(commands, axis=1) + least) * (1 + 1e-9) + 1e-9).all()
    assert (
        np.linalg.norm(np.cumsum(commands - wanted, axis=0), axis=1) / np.arange(1, 3001) < 0.2
    ).all()
    changes = (np.diff(commands, axis=0) != 0.0).any(axis=1)
    assert changes.mean() < 0.25


def test_stronger_forces_are_never_weaker_commands(choice):
    person = built(choice)
    sizes = []
    for size in np.linspace(0.01, 50.0, 400):
        person.pause()
        sizes.append(person.step(np.array([0.0, size, 0.0]))[1])
    assert (np.diff(sizes) > 0.0).all()


def test_what_the_device_plays_uncompressed_is_what_was_commanded(choice):
    """The uncompressed force of the device equals the command.

    Forces up to the knee of the device's range are commanded at or below it, so that ratios of
    intensity survive.
    """
    person, device = built(choice), ForceRange(limit_N=LIMIT_N)
    for size in (0.3, 1.0, 0.7 * LIMIT_N):
        person.pause()
        command = person.step(np.array([size, 0.0, 0.0])).copy()
        felt, compressed = device.play(command)
        assert np.array_equal(felt, command) and (not compressed or size == 0.7 * LIMIT_N)
    person.pause()
    assert device.play(person.step(np.array([40.0, 0.0, 0.0])))[0][0] <= LIMIT_N


def test_a_force_that_is_none_is_refused_and_changes_nothing(choice):
    person = built(choice)
    person.step(np.array([0.0, 0.0, 1.0]))
    before = person.step(np.array([0.0, 0.0, 1.0])).copy()
    for bad in (np.nan, np.inf):
        with pytest.raises(InputError, match=r"force must be finite, got .*. Use a SampleGuard"):
            person.step(np.array([0.0, bad, 1.0]))
    assert np.array_equal(person.step(np.array([0.0, 0.0, 1.0])), before)


def test_the_estimate_follows_the_command(choice):
    person = built(choice)
    for _ in range(1000):
        command = person.step(np.array([0.0, 1.5, 0.0]))
    estimates = []
    for _ in range(3000):
        person.step(np.array([0.0, 1.5, 0.0]))
        estimates.append(person.estimated_N)
    assert np.mean(estimates) == pytest.approx(command[1], rel=0.15) and min(estimates) >= 0.0


def test_unknown_names_are_refused():
    with pytest.raises(
        InputError, match="perception must be one of none, population or observer:FILE, got expert"
    ):
        built("expert")
    with pytest.raises(InputError, match=r"observer must be an observer file, got nowhere.json"):
        built("observer:nowhere.json")


def test_observers_who_cannot_be_inverted_are_refused():
    unsure = Observer.known(
        "unsure",
        alpha=1.0,
        beta=0.5,
        kappa=0.07,
        offset_N=0.1,
        lapse=0.02,
        sigma=0.2,
        spread={"beta": 1.5},
    )
    with pytest.raises(InputError, match=r"beta must be known well enough to be inverted, got 0.5"):
        perception(unsure, rng=np.random.default_rng(0), force_limit_N=LIMIT_N, tick_s=TICK)
    with pytest.raises(
        InputError, match=r"force_limit_N must be positive|limit_N must be positive"
    ):
        perception(
            reference_observer(), rng=np.random.default_rng(0), force_limit_N=-1.0, tick_s=TICK
        )
