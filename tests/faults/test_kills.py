"""Commands killed at random moments, and stopped by signals.

Finished work is kept, nothing is left behind.
"""

import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from uuid import uuid4

import psutil
import pytest

from tissue.simulation.run_folder import SavedRun

pytestmark = [
    pytest.mark.timeout(1800),
    pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no SIGKILL"),
]
ROOT = Path(__file__).resolve().parents[2]
SEED, KILLS = 15, 1
"""Seed of all moments, and kills of each command."""
MARK = "TISSUE_TEST_MARK"
MOLAR = (
    *("run", "molar", "--set", "voxels.spacing_mm=0.2", "--set", "stress.cell_mm=0.8"),
    *(
        "--set",
        "stress.interval_ms=10",
        "--set",
        "motion.feed_mm_s=3",
        "--duration-s",
        "0.1",
        "--no-pictures",
    ),
)
STUDY = (
    *(
        "study",
        "run",
        "--trials",
        "2",
        "--tasks",
        "T2",
        "--groups",
        "novice",
        "--methods",
        "penalty",
    ),
    *("--workers", "2"),
)


class Command:
    """The ``tissue`` command in a process of its own.

    All processes that it starts are found by its mark.
    """

    def __init__(self, place, *arguments):
        self.mark = uuid4().hex
        variables = {"PYTHONPATH": str(ROOT), "TISSUE_CACHE": str(place / "cache"), MARK: self.mark}
        heeding = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
        self.begun = place / f"{self.mark}.begun"
        code = (
            heeding
            + f"from tissue.__main__ import main; open({str(self.begun)!r}, 'w').close(); main()"
        )
        self.process = subprocess.Popen(
            [sys.executable, "-c", code, *map(str, arguments)],
            cwd=place,
            env=os.environ | variables,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )

    def stopped_after(self, seconds, how):
        """Send a signal some time after the first own line, unless the command has ended.

        Returns whether it was sent, and the output.
        """
        until = time.monotonic() + 60.0
        while not self.begun.exists() and time.monotonic() < until:
            time.sleep(0.005)
        try:
            message = self.process.communicate(timeout=seconds)[1]
            return False, message
        except subprocess.TimeoutExpired:
            self.process.send_signal(how)
            return True, self.process.communicate(timeout=120.0)[1]

    def left(self, within_s=30.0):
        """Return the processes that the parent started and that have not ended after a while."""
        until = time.monotonic() + within_s
        while (
            found := [each for each in psutil.process_iter() if self._is_ours(each)]
        ) and time.monotonic() < until:
            time.sleep(0.1)
        return found

    def _is_ours(self, process):
        try:
            return (
                process.environ().get(MARK) == self.mark
                and process.status() != psutil.STATUS_ZOMBIE
            )
        except psutil.Error:
            return False


def check_run(out, whole, *, killed):
    """An interrupted run has the first rows of the whole one; a whole one all its files."""
    if not out.is_dir():
        return
    if not (out / "summary.json").is_file():
        assert killed and not [each for each in out.iterdir() if not each.name.startswith(".")]
        return
    saved = SavedRun(out)
    assert saved.status == ("interrupted" if killed and not saved.complete else "complete")
    if (out / "trace.csv").is_file():
        text = (out / "trace.csv").read_bytes()
        rows = text[: text.rfind(b"\n") + 1]
        assert (whole / "trace.csv").read_bytes().startswith(rows) and (killed or rows == text)
    if not killed:
        for name in ("trace.csv", "bone.stl", "bone.nrrd", "scene.toml"):
            assert (out / name).read_bytes() == (whole / name).read_bytes(), name
        # A kill while a frame is written leaves its hidden temporary file.
        frames = [len(list((run / "fields").glob("frame_*.vtu"))) for run in (out, whole)]
        assert frames[0] == frames[1] > 5


def check_study(out, whole, *, killed):
    """Check that every trial of a killed study is whole.

    The tables of a study that continued equal the tables of one that never stopped.
    """
    kept = [each for each in out.glob("trials/*.json") if not each.name.startswith(".")]
    for each in kept:
        assert (
            json.loads(each.read_text())["rows"]
            == json.loads((whole / "trials" / each.name).read_text())["rows"]
        )
    if not killed:
        assert len(kept) == 2
        assert (out / "trials.csv").read_bytes() == (whole / "trials.csv").read_bytes()


def check_session(out, whole, *, killed):
    """Check that the log holds the first trials of the whole session.

    The observer exists only at the end.
    """
    name = "observer.trials.jsonl"
    log = out.with_name(name)
    if log.exists():
        text = log.read_bytes()
        lines = text[: text.rfind(b"\n") + 1]
        assert whole.with_name(name).read_bytes().startswith(lines)
    if out.exists() or not killed:
        assert (
            out.read_bytes() == whole.read_bytes()
            and log.read_bytes() == whole.with_name(name).read_bytes()
        )


CASES = {
    "run": (MOLAR, "run", check_run, True),
    "study": (STUDY, "study", check_study, False),
    "calibrate": (
        ("calibrate", "--observer", "simulated:1", "--trials", "12", "--numbers", "4"),
        "observer.json",
        check_session,
        False,
    ),
}
"""Command line, name of its output, what is held of it, and whether it begins anew after a kill."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Make a command's output without a stop, once: where it lies, and how long it took [s]."""
    made = {}

    def make(kind):
        if kind not in made:
            place = tmp_path_factory.mktemp(kind)
            line, name, *_ = CASES[kind]
            began = time.monotonic()
            command = Command(place, *line, "--out", place / name)
            message = command.process.communicate(timeout=900.0)[1]
            assert command.process.returncode == 0, message
            assert not command.left(10.0)
            made[kind] = place / name, time.monotonic() - began
        return made[kind]

    return make


@pytest.mark.slow
@pytest.mark.parametrize("kind", CASES)
def test_a_kill_at_any_moment_loses_only_the_work_in_progress(tmp_path, whole, kind):
    """A kill at any moment loses only the work in progress.

    Moments are drawn within the command's duration; after the kills it is run to its end on the
    files left.
    """
    wanted, lasts_s = whole(kind)
    line, name, check, anew = CASES[kind]
    out, rng = tmp_path / name, random.Random(f"{SEED} {kind}")
    for turn in range(KILLS):
        again = ["--overwrite"] if anew and turn else []
        command = Command(tmp_path, *line, "--out", out, *again)
        killed, message = command.stopped_after(rng.uniform(0.1, 1.0) * lasts_s, signal.SIGKILL)
        assert not command.left(), "a helper outlived it"
        assert killed or command.process.returncode == 0 or (turn and "must not" in message), (
            message
        )  # it was whole before
        check(out, wanted, killed=killed)
        if not killed and not anew:
            break  # it had come to its end
    command = Command(tmp_path, *line, "--out", out, *(["--overwrite"] if anew else []))
    message = command.process.communicate(timeout=900.0)[1]
    if "must not" not in message:  # else it had come to its end before
        assert command.process.returncode == 0, message
    check(out, wanted, killed=False)


STOPPED = {
    **{kind: line for kind, (line, *_) in CASES.items()},
    "pictures": MOLAR[:-1],
    "train": ("train", "wall", "--trials", "6", "--set", "duration_s=1"),
    "atlas": ("stability", "--only", "wall_map"),
}


PROGRESS = re.compile(r".*, \d+ %\n|\d+ trials? will take .*\n")
"""Progress that a command prints where no terminal shows a bar, and the estimate of a study."""


MOMENTS_S = {"SIGINT": (0.1, 0.6), "SIGTERM": (1.5, 6.0)}
"""Range of the time of a stop after the start: during the imports, and at work."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "how"), [("run", "SIGINT"), *((kind, "SIGTERM") for kind in STOPPED)]
)
def test_a_stop_is_met_in_one_sentence(tmp_path, kind, how):
    """With 130 and 143, and nothing is left running."""
    seconds = random.Random(f"{SEED} {kind} {how}").uniform(*MOMENTS_S[how])
    suffix = {"calibrate": ".json", "train": ".npz"}.get(kind, "")
    out = tmp_path / f"out{suffix}"
    command = Command(tmp_path, *STOPPED[kind], "--out", out)
    stopped, printed = command.stopped_after(seconds, getattr(signal, how))
    message = "".join(
        line for line in printed.splitlines(keepends=True) if not PROGRESS.match(line)
    )
    assert "Traceback" not in message and message.count("\n") <= 1, printed
    code = command.process.returncode
    assert code != 2, message
    # Python was ending after the command's last line: a shell shows 130 or 143
    if code == -getattr(signal, how):
        assert out.exists() and "stopped" not in message
    elif stopped and code != 0:
        assert code == (130 if how == "SIGINT" else 143), message
        assert message.startswith("stopped")
    assert not command.left(), "a helper outlived it"
    if (out / "summary.json").is_file():
        assert SavedRun(out).status in ("interrupted", "complete")
    assert not list(tmp_path.rglob(".lock")) and not list(tmp_path.rglob(".*.lock"))
