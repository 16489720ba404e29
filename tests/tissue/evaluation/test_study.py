"""Study: its plan, its folder, and runs that are stopped, resumed and broken.

The trials cost nothing.
"""

from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from meshes.base.errors import InputError
from tissue.evaluation.study import folder as folder_module
from tissue.evaluation.study.folder import run_study
from tissue.evaluation.study.plan import METHODS, TASKS, USERS, Plan, TrialKey
from tissue.evaluation.study.trial import Trial, run_trial, trial_seed

SMALL = Plan(trials=3, tasks=("T2", "needle"))


def cheap(plan, key):
    """A trial of the right shape whose numbers follow from its seed."""
    seed = trial_seed(plan, key)
    rng = np.random.default_rng(seed)
    rows = [
        {"method": each, "force_error": rng.random(), "position_error_mm": rng.random()}
        for each in plan.methods
    ]
    return Trial(key, seed, tuple(rows), 0.0)


class Direct(Executor):
    """Runs at once what is submitted; `lose` may break it before a trial."""

    def __init__(self, lose):
        self._lose, self.calls = lose, []

    def submit(self, act, /, *given):
        self.calls.append(given[0])
        future = Future()
        if self._lose(given[0]):
            future.set_exception(BrokenExecutor("a worker was killed"))
        else:
            try:
                future.set_result(act(*given))
            except Exception as error:
                future.set_exception(error)
        return future


@pytest.fixture
def pool(monkeypatch):
    """Trials that cost nothing, on an executor that can be made to lose workers."""
    held = Direct(lambda key: False)

    @contextmanager
    def given(workers, scheduler, *, patience_s):
        yield held

    monkeypatch.setattr("tissue.system.workers.executor", given)
    monkeypatch.setattr(folder_module, "run_trial", cheap)
    monkeypatch.setattr("tissue.system.workers.sleep", lambda seconds: None)
    return held


def table(out):
    return (out / "trials.csv").read_bytes(), (out / "needle.csv").read_bytes()


def test_a_plan_counts_its_trials():
    """A plan counts its trials.

    3 tasks x 3 groups x 100 are the paper's 900; case studies are added to them.
    """
    keys = list(Plan().all_trials())
    assert sum(not TASKS[key.task].case for key in keys) == 900
    assert sum(key.task == "reaming" for key in keys) == 60
    assert len({key.name for key in keys}) == len(keys)
    assert all(TrialKey.named(key.name) == key for key in keys)


def test_people_get_all_specimens_as_often_and_begin_with_different_ones():
    for task in ("T1", "T2", "T3"):
        counts = np.zeros((USERS, 3), dtype=int)
        for trial in range(3 * USERS):
            key = TrialKey(task, "novice", trial)
            counts[key.user, key.specimen] += 1
        assert (counts == 1).all()
        assert {TrialKey(task, "novice", user).specimen for user in range(3)} == {0, 1, 2}
    # every person reams as often
    for group in ("novice", "expert"):
        users = [
            key.user for key in Plan().all_trials() if (key.task, key.group) == ("reaming", group)
        ]
        assert (np.bincount(users) == 2).all() and len(set(users)) == USERS


def test_seeds_belong_to_trials_and_to_nothing_else():
    few, many = Plan(trials=2, tasks=("T2",), methods=("penalty",)), Plan(trials=50)
    key = TrialKey("T2", "expert", 1)
    assert trial_seed(few, key) == trial_seed(many, key) != trial_seed(Plan(seed=1), key)
    keys = list(many.all_trials())
    assert len({trial_seed(many, key) for key in keys}) == len(keys)
    people = [
        many.person(TrialKey(task, "novice", trial)).random() for task in TASKS for trial in (3, 13)
    ]
    assert len(set(people)) == 1


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"trials": 0}, r"trials must be in \[1, 10000\], got 0. Use a value such as 100"),
        (
            {"tasks": ("T9",)},
            "tasks must each be one of T1, T2, T3, needle, reaming, drilling, got T9",
        ),
        ({"groups": ()}, "groups must each be one of novice, intermediate, expert, got nothing"),
        (
            {"methods": ("penalty", "penalty")},
            "methods must each be .* got penalty,penalty. Choose one or more",
        ),
    ],
)
def test_a_plan_that_makes_no_sense_is_refused(given, message):
    with pytest.raises(InputError, match=message):
        Plan(**given)


@pytest.mark.slow
def test_a_study_that_is_stopped_goes_on(tmp_path, pool):
    """A study that is stopped continues.

    Stopped after every trial in turn, it runs each once and gives the table of an unbroken study.
    """
    plan = replace(SMALL, trials=2)
    run_study(plan, tmp_path / "whole", workers=2)
    whole = len(pool.calls)
    pool.calls.clear()
    out, total = tmp_path / "broken", len(list(plan.all_trials()))

    class StopError(Exception):
        pass

    def stop(doing, share):
        if doing.startswith("trial "):
            raise StopError

    for done in range(1, total + 1):
        with pytest.raises(StopError):
            run_study(plan, out, workers=1, report=stop)
        assert (
            len(list((out / "trials").glob("*.json"))) == min(3 * done, total) or done * 3 > total
        )
        if len(list((out / "trials").glob("*.json"))) == total:
            break
    run_study(plan, out, workers=1)
    assert table(out) == table(tmp_path / "whole")
    assert whole == total and set(pool.calls) == set(plan.all_trials())


@pytest.mark.slow
def test_a_trial_that_ends_its_worker_is_kept_as_failed(tmp_path, pool):
    """The others are not blamed, though they were under way when it went."""
    culprit = TrialKey("T2", "expert", 1)
    pool._lose = lambda key: key == culprit
    folder = run_study(SMALL, tmp_path / "study", workers=2)
    failed = folder.table("T2")
    assert failed.failed == len(METHODS) and set(failed.where(group="expert").failure) == {
        "",
        "RuntimeError: the worker was lost each time this job ran on it",
    }
    pool._lose = lambda key: False
    assert run_study(SMALL, tmp_path / "study").table("T2").failed == len(METHODS)
    assert run_study(SMALL, tmp_path / "study", retry=True).table("T2").failed == 0


def test_a_study_whose_workers_never_live_gives_up(tmp_path, pool):
    pool._lose = lambda key: True
    with pytest.raises(InputError, match="workers must stay alive, got"):
        run_study(SMALL, tmp_path / "study")


def test_a_trial_file_that_is_cut_short_is_run_again(tmp_path, pool):
    out, reported = tmp_path / "study", []
    folder = run_study(SMALL, out)
    before = table(out)
    cut, gone = out / "trials" / "T2-novice-0001.json", out / "trials" / "needle-expert-0002.json"
    cut.write_bytes(cut.read_bytes()[:50])
    gone.unlink()
    pool.calls.clear()
    run_study(SMALL, out, report=lambda doing, share: reported.append(doing))
    assert reported[0] == "trial T2-novice-0001 was cut short and is run again"
    assert sorted(key.name for key in pool.calls) == ["T2-novice-0001", "needle-expert-0002"]
    assert table(out) == before and len(folder.table("T2")) == 3 * 3 * len(METHODS)


def test_progress_of_a_continued_study_begins_at_the_completed_share(tmp_path, pool):
    """The remaining time is estimated from the growth of the share, so no report states zero."""
    out = tmp_path / "study"
    run_study(SMALL, out)
    done = len(list(SMALL.all_trials())) - 2
    (out / "trials" / "T2-novice-0001.json").write_text("{")
    (out / "trials" / "needle-expert-0002.json").unlink()
    reported = []
    run_study(SMALL, out, report=lambda doing, share: reported.append((doing, share)))
    assert "was cut short" in reported[0][0] and "2 trials will take" in reported[1][0]
    shares = [share for _, share in reported]
    # trials of the two tasks take different times
    assert shares[0] == pytest.approx(done / (done + 2), abs=0.03)
    assert shares == sorted(shares) and shares[-1] == 1.0


def test_the_command_prints_messages_before_the_first_trial(here, pool, command):
    """Both a new and a continued study print messages. Only the bar shows the finished trials."""
    asked = ("study", "run", "--trials", 2, "--tasks", "T2", "--workers", 1, "--out", "study")
    code, _, err = command(*asked)
    assert code == 0 and " trials will take " in err and "trial 6 of" not in err
    (here / "study" / "trials" / "T2-novice-0001.json").write_text("{")
    code, _, err = command(*asked)
    assert code == 0 and "T2-novice-0001 was cut short" in err and "1 trial will take " in err


@pytest.mark.slow
def test_a_trial_alone_is_the_trial_of_its_study_and_fails_alone(monkeypatch):
    """One method on the quickest task, twice bit for bit; then one whose method cannot be run."""
    plan, key = Plan(methods=("koopman-perception",)), TrialKey("drilling", "novice", 2)
    one, other = (
        run_trial(each, key) for each in (plan, replace(plan, trials=7, groups=("novice",)))
    )
    assert one.rows == other.rows and "failure" not in one.rows[0]
    assert one.rows[0]["force_error"] > 0.0 and one.seed == trial_seed(plan, key)
    broken = {"penalty": {"renderer": "nothing"}, "koopman": METHODS["koopman"]}
    monkeypatch.setattr("tissue.evaluation.study.plan.METHODS", dict(METHODS) | broken)
    failed = run_trial(replace(plan, methods=("penalty", "koopman")), key)
    assert all(
        row["failure"].startswith("InputError: device.renderer must be one of")
        for row in failed.rows
    )
