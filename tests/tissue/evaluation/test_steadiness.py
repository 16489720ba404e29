"""Tremor of a hand from a recorded run: closed form, invariance, and known simulated hands."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

import tissue
from meshes.base.errors import InputError
from tissue.evaluation import ranking
from tissue.evaluation.ranking import Person
from tissue.evaluation.steadiness import hand_motion_m, steadiness
from tissue.haptics.device.device import device_parameters
from tissue.haptics.hand.hand import hand_parameters

TICK_S = 1e-3
DEVICE = replace(device_parameters("six-dof"), friction_N=0.0)
FREE = np.zeros((4000, 3))


def shaken(size_m, frequency_Hz=10.0):
    """A device that moves as a sine along x and slowly along y, shape (4000, 3)."""
    time_s = TICK_S * np.arange(4000)
    wave = size_m * np.sin(2.0 * np.pi * frequency_Hz * time_s)
    return np.column_stack([wave, 0.01 * np.sin(np.pi * time_s), np.zeros(4000)])


def forces_at_10_Hz():
    """Complex force per motion at 10 Hz: of the grip, and to move hand and device [N/m]."""
    grip = hand_parameters("intermediate")
    s = 2j * np.pi * 10.0
    pulls = grip.stiffness_N_m * (1.0 + grip.reflex_share * np.exp(-s * grip.reflex_s))
    moves = (grip.mass_kg + DEVICE.mass_kg) * s**2 + DEVICE.damping_N_s_m * s
    return pulls + grip.damping_N_s_m * s, moves


def test_a_shaken_device_without_force_has_the_tremor_of_the_closed_form():
    pulls, moves = forces_at_10_Hz()
    ratio = abs(1.0 + moves / pulls)
    # Of the band around the geometric mean of its ends, 10 Hz lies 0.1 % below the middle.
    found = steadiness(shaken(1e-4), FREE, DEVICE)
    assert found.tremor_mm == pytest.approx(0.1 * ratio / np.sqrt(2.0), rel=0.01)
    assert found.low < found.score < found.high
    twice = steadiness(shaken(2e-4), FREE, DEVICE)
    assert found.score - twice.score == pytest.approx(100.0 * np.log(2.0) / np.log(2.5), rel=1e-4)


def test_motions_outside_the_band_are_no_tremor():
    for frequency_Hz in (2.0, 30.0):
        outside = steadiness(shaken(1e-3, frequency_Hz), FREE, DEVICE).tremor_mm
        assert outside < 0.02 * steadiness(shaken(1e-3), FREE, DEVICE).tremor_mm


def test_tremor_does_not_depend_on_the_frame():
    rng = np.random.default_rng(3)
    position = shaken(1e-4) + np.cumsum(1e-5 * rng.normal(size=(4000, 3)), axis=0)
    force = rng.normal(size=(4000, 3))
    turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    real = device_parameters("touch")
    one = steadiness(position, force, real)
    other = steadiness(position @ turned + 0.3, force @ turned, real)
    assert other.tremor_mm == pytest.approx(one.tremor_mm, rel=1e-9)
    mirror = np.array([1.0, -1.0, 1.0])
    mirrored = steadiness(position * mirror, force * mirror, real)
    assert mirrored.tremor_mm == pytest.approx(one.tremor_mm, rel=1e-9)
    moved = position + 1e-9 * rng.normal(size=position.shape)
    assert steadiness(moved, force, real).tremor_mm == pytest.approx(one.tremor_mm, rel=1e-3)


def test_a_hand_without_tremor_scores_far_above_an_expert_even_with_encoder_steps():
    """Tremor of a smooth path, read in steps of a Touch and of a finer device."""
    time_s = TICK_S * np.arange(4000)
    path = 0.02 * np.column_stack([np.sin(np.pi * time_s), np.cos(2.0 * time_s), 0.5 * time_s])
    exact = steadiness(path, FREE, DEVICE).tremor_mm
    assert exact < 0.003
    for step_m, limit_mm in ((5.5e-5, 0.012), (1e-5, 0.004)):
        steps = step_m * np.round(path / step_m)
        assert steadiness(steps, FREE, DEVICE).tremor_mm < limit_mm


def test_a_force_of_the_motor_is_no_intended_motion():
    """A hand that holds still while its device is shaken by a known force has no tremor."""
    pulls, moves = forces_at_10_Hz()
    moved = 1e-4 * np.exp(2j * np.pi * 10.0 * TICK_S * np.arange(4000))
    force = (pulls + moves) * moved
    along = np.array([1.0, 0.0, 0.0])
    position, force = (each.real[:, None] * along for each in (moved, force))
    grip = hand_parameters("intermediate")
    rest = hand_motion_m(position, force, DEVICE, grip, band_Hz=(8.0, 12.0))
    assert np.abs(rest[1000:-1000]).max() < 2e-3 * 1e-4


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Folder with two runs on the wall for each hand, and one of an expert as reference.

    Hands use two devices at two paces.
    """
    folder = tmp_path_factory.mktemp("trainees")
    for hand in ("novice", "intermediate", "expert"):
        for number, (device, feed) in enumerate((("touch", 100.0), ("six-dof", 70.0))):
            run = tissue.simulate(
                tissue.load_scene(
                    "wall",
                    {
                        "device": device,
                        "hand": hand,
                        "seed": 5 + number,
                        "motion.feed_mm_s": feed,
                        "duration_s": 2.2,
                    },
                )
            )
            run.save(folder / "people" / hand / f"run{number}", pictures=False)
    return folder / "people"


@pytest.mark.slow
def test_hands_are_ranked_by_skill_on_any_device_and_pace(runs, tmp_path):
    found = tissue.rank(runs, runs / "expert" / "run0")
    assert [person.name for person in found.people] == ["expert", "intermediate", "novice"]
    scores = [person.scores for person in found.people]
    assert scores[0].min() > scores[1].max() and scores[1].min() > scores[2].max()
    for person in found.people:
        true_mm = np.sqrt(3.0) * 1e3 * hand_parameters(person.name).tremor_m
        for attempt in person.attempts:
            assert attempt.steadiness.tremor_mm == pytest.approx(true_mm, rel=0.5)
    written = found.save(tmp_path / "out")
    rows = (tmp_path / "out" / "ranking.csv").read_text().splitlines()
    assert rows[0].endswith(",depth_limit_mm,intervals_over_depth_limit")
    assert len(rows) == 7 and rows[1].startswith("1,expert,run0,")
    assert [path.name for path in written] == ["ranking.csv", "ranking.png"]
    with pytest.raises(InputError, match="out must not contain another ranking"):
        found.save(tmp_path / "out")


@pytest.mark.slow
def test_the_command_ranks_a_folder_of_trainees(runs, command, refused, here):
    reference = runs / "expert" / "run0"
    code, text = command("assess", runs, "--against", reference, "--out", "ranked")[:2]
    assert code == 0 and "1. expert: " in text and "3. novice: " in text
    assert (here / "ranked" / "ranking.png").stat().st_size > 10_000
    limits = ("--force-limit-N", 1e-3, "--deviation-limit-mm", 99, "--overshoot-limit-mm", 99)
    assert command("assess", runs, "--against", reference, "--out", "strict", *limits)[0] == 0
    header, *rows = (here / "strict/ranking.csv").read_text().splitlines()
    for row in rows:
        known = dict(zip(header.split(","), row.split(","), strict=True))
        assert known["force_limit_N"] == "0.001" and int(known["intervals_over_force_limit"]) > 0
        assert known["intervals_over_deviation_limit"] == "0"
        assert known["intervals_over_depth_limit"] == "0"
    (here / "people" / "nobody").mkdir(parents=True)
    assert "folder must contain at least one run of each trainee" in refused(
        "assess", "people", "--against", reference
    )
    assert "--deviation-limit-mm must be left out without --against" in refused(
        "report", reference, "--deviation-limit-mm", 2
    )


def test_a_run_without_contact_is_left_out_and_the_others_are_ranked(runs, tmp_path):
    people = tmp_path / "people"
    for name in ("anna", "ben"):
        shutil.copytree(runs / "expert" / "run0", people / name / "run0")
    shutil.copytree(runs / "novice" / "run0", people / "ben" / "run1")
    path = people / "ben" / "run1" / "trace.csv"
    header, *lines = path.read_text().splitlines()
    forces = [at for at, name in enumerate(header.split(",")) if name.startswith("model_force_")]
    assert len(forces) == 3
    rows = [line.split(",") for line in lines]
    for row in rows:
        for at in forces:
            row[at] = "0"
    path.write_text("\n".join([header, *map(",".join, rows)]) + "\n")
    found = tissue.rank(people, runs / "expert" / "run1")
    assert [(each.name, len(each.attempts)) for each in found.people] == [("anna", 1), ("ben", 1)]
    assert found.left_out == (f"{path.parent} touches nothing",)
    assert f"left out: {path.parent} touches nothing" in str(found).splitlines()


def test_a_report_contains_the_assessment(runs, tmp_path):
    trainee, reference = runs / "novice" / "run0", runs / "expert" / "run0"
    path = tissue.report(trainee, tmp_path / "report.html", against=reference)
    text = path.read_text("utf-8")
    assert "<h2>Assessment</h2>" in text and "<li>score: " in text
    limited = tmp_path / "limited.html"
    limits = {"force_limit_N": 7.25, "deviation_limit_mm": 3.5, "overshoot_limit_mm": 1000.0}
    text = tissue.report(trainee, limited, against=reference, **limits).read_text("utf-8")
    assert "limits: force 7.25 N, distance from the path 3.5 mm, depth 1e+03 mm" in text
    for name, value in limits.items():
        words = f"{name} must be left out without a reference run"
        with pytest.raises(InputError, match=words):
            tissue.report(trainee, tmp_path / "c.html", **{name: value})
    assert "<h2>Assessment</h2>" not in tissue.report(trainee, tmp_path / "b.html").read_text()


class Scored(Person):
    """Trainee whose scores are given."""

    def __init__(self, scores):
        object.__setattr__(self, "attempts", tuple(scores))

    @property
    def scores(self):
        return np.array(self.attempts, dtype=float)


def test_the_interval_of_a_mean_covers_95_percent_and_a_gain_is_the_slope():
    rng = np.random.default_rng(0)
    inside = 0
    for _ in range(2000):
        low, high = Scored(rng.normal(40.0, 12.0, 5)).interval
        inside += low < 40.0 < high
    assert inside / 2000 == pytest.approx(0.95, abs=0.015)
    slope, low, high = Scored(10.0 + 4.0 * np.arange(6)).gain
    assert slope == pytest.approx(4.0) and low == pytest.approx(4.0) and high == pytest.approx(4.0)
    assert Scored([1.0, 2.0]).gain is None


def test_a_gain_whose_interval_contains_zero_shows_no_change(monkeypatch):
    monkeypatch.setattr(Scored, "name", "p03", raising=False)
    monkeypatch.setattr(ranking.Ranking, "structures", [])
    monkeypatch.setattr(ranking, "_limit_lines", lambda found: [])
    few = [21.0, 37.0, 22.0]
    many = 10.0 + 4.0 * np.arange(6)
    words = "the attempts show no change, because this interval contains 0"
    for scores, is_few in ((few, True), (many, False)):
        lines = ranking.ranking_lines(ranking.Ranking("cavity", (Scored(scores),)))
        assert any(line.endswith(words) for line in lines) == is_few


def test_a_run_without_a_device_or_too_short_has_no_score(tmp_path):
    scene = tissue.load_scene("milling", {"voxels.spacing_mm": 0.4, "duration_s": 0.2})
    tissue.simulate(scene).save(tmp_path / "people" / "scripted", pictures=False)
    found = tissue.rank(tmp_path / "people", tmp_path / "people" / "scripted")
    assert "scripted has no score: the run has no device" in found.left_out[0]
    assert str(found).startswith("milling: no run has a score")
    assert [path.name for path in found.save(tmp_path / "out")] == ["ranking.csv"]
    header, row = (tmp_path / "out" / "ranking.csv").read_text().splitlines()
    known = dict(zip(header.split(","), row.split(","), strict=True))
    assert known["trainee"] == "scripted" and known["rank"] == known["score"] == ""
    assert float(known["peak_force_N"]) > 0.0 and float(known["removed_mm3"]) > 0.0
    with pytest.raises(InputError, match=r"run must last at least 1 s, got 0\.9 s\. "):
        steadiness(FREE[:900], FREE[:900], DEVICE)
    with pytest.raises(InputError, match=r"at 6\.3 mm/s or faster for 0 % of the scored 4") as slow:
        steadiness(0.1 * shaken(1e-4), FREE, DEVICE)
    # the device is slow all the time, so a shorter run does not help
    # A faster tool would be no better treatment.
    assert "Set a smaller coupling.motion_scale" in str(slow.value)
    assert "Move faster" not in str(slow.value)
    assert "duration_s" not in str(slow.value)


def test_a_rest_after_the_scored_ticks_does_not_change_the_score():
    moving = shaken(1e-4)
    rest = np.broadcast_to(moving[-1], (4 * len(moving), 3))
    whole = np.concatenate([moving, rest])
    force = np.zeros_like(whole)
    with pytest.raises(InputError, match="farther, or end the run when the hand rests"):
        steadiness(whole, force, DEVICE)
    found = steadiness(whole, force, DEVICE, scored=len(moving))
    # measured: 1.1e-6
    assert found.score == pytest.approx(steadiness(moving, FREE, DEVICE).score, abs=1e-4)
