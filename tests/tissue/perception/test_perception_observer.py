"""Observers and their files: round trips, drawn people, and everything that is refused."""

import json

import numpy as np
import pytest
from held_back import held_back

from tissue import InputError
from tissue.perception.laws import Weber, weber_of
from tissue.perception.observer import (
    PARAMETERS,
    Observer,
    read_observer,
    write_observer,
)
from tissue.perception.perceived import Deadband

GIVEN = {"alpha": 0.9, "beta": 1.5, "kappa": 0.06, "offset_N": 0.15, "lapse": 0.03, "sigma": 0.25}
SPREAD = {"alpha": 0.2, "beta": 0.1, "kappa": 0.15, "offset_N": 0.3, "lapse": 0.5, "sigma": 0.2}


def observer(**changed):
    return Observer.known("ada", **(GIVEN | changed), spread=SPREAD, trials=120)


def test_medians_are_what_was_given():
    one = observer()
    for name in PARAMETERS:
        assert getattr(one, name) == pytest.approx(GIVEN[name], rel=1e-12)


def test_draws_give_the_observer_back():
    one = observer()
    again = Observer.from_draws("ada", one.draw(200_000, np.random.default_rng(0)), trials=120)
    assert again.mean == pytest.approx(one.mean, abs=0.01) and again.covariance == pytest.approx(
        one.covariance, abs=0.01
    )


def test_a_file_gives_the_same_bits_back(tmp_path):
    rng = np.random.default_rng(1)
    root = 0.1 * rng.standard_normal((6, 6))
    one = Observer(name="ada", mean=observer().mean, covariance=root @ root.T, trials=7)
    write_observer(one, tmp_path / "ada.json")
    again = read_observer(tmp_path / "ada.json")
    assert np.array_equal(again.mean, one.mean) and np.array_equal(again.covariance, one.covariance)
    assert (again.name, again.trials) == ("ada", 7)
    assert [path.name for path in tmp_path.iterdir()] == ["ada.json"]


def test_a_file_holds_exponent_and_threshold_in_plain_numbers(tmp_path):
    """The numbers of a reader without the package agree with the observer's."""
    path = tmp_path / "ada.json"
    one = observer()
    write_observer(one, path)
    plain = json.loads(path.read_text("utf-8"))
    assert plain["exponent"] == pytest.approx(GIVEN["beta"], rel=1e-5)
    at_N = plain["threshold_at_N"]
    assert plain["threshold_N"] == pytest.approx(float(weber_of(one).threshold(at_N)), rel=1e-5)
    by_hand = plain["weber_fraction"] * (at_N + plain["offset_N"])
    assert plain["threshold_N"] == pytest.approx(by_hand, rel=1e-5)


def test_a_file_without_plain_numbers_is_read(tmp_path):
    """Files of earlier versions have no plain numbers."""
    path = tmp_path / "ada.json"
    write_observer(observer(), path)
    stored = json.loads(path.read_text("utf-8"))
    for name in ("exponent", "weber_fraction", "offset_N", "threshold_at_N", "threshold_N"):
        del stored[name]
    path.write_text(json.dumps(stored), "utf-8")
    assert np.array_equal(read_observer(path).mean, observer().mean)


def test_a_file_is_never_replaced_unasked(tmp_path):
    path = tmp_path / "ada.json"
    write_observer(observer(), path)
    before = path.read_text("utf-8")
    with pytest.raises(
        InputError, match=r"out must not exist yet, got .*ada.json. Pass --overwrite"
    ):
        write_observer(observer(beta=1.9), path)
    assert path.read_text("utf-8") == before
    write_observer(observer(beta=1.9), path, overwrite=True)
    assert read_observer(path).beta == pytest.approx(1.9)
    with pytest.raises(InputError, match="out must lie in a folder that exists"):
        write_observer(observer(), tmp_path / "no" / "folder" / "ada.json")


def spoil(**changed):
    def change(message):
        return json.dumps(message | changed)

    return change


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda message: "{", "be an observer file, got .*ada.json"),
        (lambda message: "[1, 2]", "be an observer file"),
        (lambda message: '{"format": "tissue run"}', "be an observer file, got .*another format"),
        (spoil(version=2), "must have format 1 or older, got format 2 in"),
        (spoil(mean="unknown"), "observer .*ada.json"),
        (spoil(coordinates=["ln alpha"]), "other coordinates"),
        (spoil(mean=[0.0] * 5), r"mean and covariance must have shapes .* got \(5,\)"),
        (spoil(mean=[0.0, 1.7, float("nan"), -1.6, -3.9, -1.6]), "mean and covariance .* finite"),
        (spoil(mean=[0.0, 17.0, -2.7, -1.6, -3.9, -1.6]), r"beta must be in \[0.05, 5\], got 17"),
        (spoil(mean=[0.0, 1.7, -2.7, 8.0, -3.9, -1.6]), r"offset_N must be in"),
        (spoil(covariance=(-np.eye(6)).tolist()), "covariance must be"),
        (spoil(covariance=np.triu(np.ones((6, 6))).tolist()), "covariance must be"),
        (spoil(covariance=(400.0 * np.eye(6)).tolist()), r"standard deviation .* got 20"),
        (spoil(trials=-3), "trials must be in"),
        (spoil(exponent=1.2), r"exponent is 1\.2, but the mean gives 1\.5\. Delete exponent"),
        (spoil(threshold_N=0.14), r"threshold_N is 0\.14, but the mean gives 0\.129"),
        (spoil(threshold_at_N=1.0), r"threshold_N is 0\.129, but the mean gives 0\.069"),
        (spoil(weber_fraction="high"), "weber_fraction is high, but the mean gives 0.06"),
        (spoil(threshold_at_N=None), "threshold_at_N is None"),
    ],
)
def test_a_bad_file_is_refused_in_one_sentence(tmp_path, change, named):
    path = tmp_path / "ada.json"
    write_observer(observer(), path)
    path.write_text(change(json.loads(path.read_text("utf-8"))), "utf-8")
    with pytest.raises(InputError, match=named) as caught:
        read_observer(path)
    assert "\n" not in str(caught.value)


def test_a_deadband_plays_the_wanted_vector_itself_and_nothing_of_noise():
    law = Weber(kappa=0.07, offset=0.2)
    rng = np.random.default_rng(3)
    noise = (
        rng.uniform(-1.0, 1.0, (5000, 3)) * 0.49 * float(law.threshold(2.0)) / np.sqrt(3.0) / 2.0
    )
    played, changed = held_back(np.array([0.0, 0.0, 2.0]) + noise, law)
    assert changed.sum() == 1 and (played == played[0]).all()
    ramp = np.column_stack([np.zeros(4000), np.zeros(4000), np.linspace(0.0, 4.0, 4000)])
    played, changed = held_back(ramp, law)
    assert np.array_equal(played[changed], ramp[changed])
    # every step is one threshold: from F, F + kappa (F + F0), so 4.2 / 0.2 in ln(21) / ln(1.07) =
    # 45 steps
    assert abs(changed.sum() - np.log(21.0) / np.log(1.07)) < 3.0


def test_a_turn_of_a_force_is_a_change():
    """A turn of a force is a change.

    Turned by an angle a, |F| moves by 2 F sin(a / 2): at 2 N the threshold is reached after 4.4
    degrees.
    """
    law = Weber(kappa=0.07, offset=0.2)
    angles = np.radians(np.linspace(0.0, 30.0, 3001))
    _, changed = held_back(
        2.0 * np.column_stack([np.sin(angles), 0.0 * angles, np.cos(angles)]), law
    )
    first = np.degrees(angles[np.flatnonzero(changed)[1]])
    assert first == pytest.approx(2.0 * np.degrees(np.arcsin(0.5 * 0.07 * 2.2 / 2.0)), abs=0.02)


def test_a_contact_that_fades_leaves_exactly_nothing():
    law = Weber(kappa=0.07, offset=0.2)
    fading = np.exp(-np.arange(4000) / 200.0)[:, None] * np.array([0.3, 0.0, 1.0])
    played, _ = held_back(fading, law)
    assert not played[-1].any()
    assert (
        np.linalg.norm(fading - played, axis=1) <= law.threshold(np.linalg.norm(played, axis=1))
    ).all()
    deadband = Deadband(law)
    assert deadband.step(0.0, 0.0, 0.0) and not deadband.step(0.0, 0.0, 0.0)
