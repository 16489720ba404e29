"""Damage to files by seed, and what their readers make of it, each read in a child process that a crash would end.

Run as a program, this file reads names of readers and files from its standard input and answers a line each: ``read``,
``refused`` with the sentence, or ``traceback`` with the error. A child that ends instead is a crash.
"""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
NUMBER = re.compile(rb"-?\d+(\.\d+)?([eE][-+]?\d+)?")
VALUES = (b"-1", b"0", b"nan", b"inf", b"1e300", b"-99999999999", b"4294967296", b"18446744073709551616", b"x", b"")


def damaged(content: bytes, seed: int) -> bytes:
    """The content of a file with one to three kinds of damage."""
    rng = np.random.default_rng(seed)
    for kind in rng.choice(8, size=rng.integers(1, 4)):
        content = _damage(content, int(kind), rng)
    return content


def _damage(content: bytes, kind: int, rng: np.random.Generator) -> bytes:
    if len(content) < 8:
        return content
    at = int(rng.integers(len(content)))
    match kind:
        case 0:  # cut short
            return content[:at]
        case 1:  # bits flipped
            flipped = bytearray(content)
            for place in rng.integers(len(content), size=4):
                flipped[place] ^= 1 << int(rng.integers(8))
            return bytes(flipped)
        case 2 | 3:  # a number replaced, in the first lines for one of the two
            found = list(NUMBER.finditer(content, 0, len(content) if kind == 2 else 600))
            if not found:
                return content
            chosen = found[int(rng.integers(len(found)))]
            return content[: chosen.start()] + VALUES[int(rng.integers(len(VALUES)))] + content[chosen.end() :]
        case 4:  # a line left out
            lines = content.split(b"\n")
            del lines[int(rng.integers(min(len(lines), 60)))]
            return b"\n".join(lines)
        case 5:  # two words of the head exchanged
            words = content[:400].split(b" ")
            if len(words) > 2:
                a, b = rng.integers(len(words), size=2)
                words[a], words[b] = words[b], words[a]
            return b" ".join(words) + content[400:]
        case 6:  # bytes put in
            return content[:at] + rng.bytes(int(rng.integers(1, 9))) + content[at:]
        case _:  # a piece twice
            return content[: at + int(rng.integers(1, 200))] + content[at:]


class Reading:
    """A child that reads files, started anew after a crash."""

    def __init__(self, *, longest_s: float = 120.0) -> None:
        self._longest_s, self._child = longest_s, None

    def read(self, reader: str, path: Path) -> tuple[str, str]:
        """``read``, ``refused``, ``traceback``, ``crash`` or ``hang``, and what was said."""
        if self._child is None:
            self._child = subprocess.Popen(
                [sys.executable, __file__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                cwd=ROOT,
            )
        child = self._child
        child.stdin.write(json.dumps([reader, str(path), self._longest_s]) + "\n")
        child.stdin.flush()
        answer = child.stdout.readline()
        if answer:
            return tuple(json.loads(answer))
        self._child = None
        code = child.wait()
        return ("hang", "") if code == 1 else ("crash", f"exit code {code}")

    def close(self) -> None:
        """End the child."""
        if self._child is not None:
            self._child.communicate("")


def _surface(path: Path) -> None:
    from meshes.surfaces.surface import read_surface

    read_surface(path)


def _image(path: Path) -> None:
    from meshes.images.reading import read_image

    read_image(path, spacing_mm=0.5 if path.suffix == ".tif" else None)


def _tets(path: Path) -> None:
    from meshes.tets.files import read_tets

    read_tets(path)


def _run_folder(path: Path) -> None:
    from tissue.simulation.run_folder import SavedRun
    from tissue.viewer.carving import bone_of
    from tissue.viewer.run import require_whole
    from tissue.viewer.show import Choice
    from tissue.viewer.view import _about, _check

    saved = SavedRun(path)
    require_whole(saved)
    _about(saved)
    _check(saved, Choice())
    bone_of(saved, saved.scene)


def _assessed(path: Path) -> None:
    from tissue.evaluation.assessment import assess, assessment_lines
    from tissue.simulation.run_folder import SavedRun

    assessment_lines(assess(SavedRun(path), SavedRun(path.parent / "run")))


def _scene(path: Path) -> None:
    from tissue.scene.load import load_scene

    load_scene(path)


def _poses(path: Path) -> None:
    from tissue.motion.replay import read_poses

    read_poses(path, step_s=1e-3)


def _predictor(path: Path) -> None:
    from tissue.prediction.trained import Trained

    Trained.read(path, scene="wall")


def _observer(path: Path) -> None:
    from tissue.perception.observer import read_observer

    read_observer(path)


def _trials(path: Path) -> None:
    from tissue.evaluation.calibration.trial_log import read_log

    read_log(path)


def _study(path: Path) -> None:
    from tissue.evaluation.study.folder import StudyFolder

    folder = StudyFolder(path)
    folder.begin(folder.plan())
    folder.write_tables()


def _table(path: Path) -> None:
    from tissue.evaluation.statistics.trials import TrialTable

    TrialTable.read_csv(path)


READERS = {
    "surface": _surface,
    "tets": _tets,
    "image": _image,
    "run": _run_folder,
    "assess": _assessed,
    "scene": _scene,
    "poses": _poses,
    "predictor": _predictor,
    "observer": _observer,
    "trials": _trials,
    "study": _study,
    "table": _table,
}


def _serve() -> None:
    """Answer requests until there are no more."""
    import faulthandler
    import os
    import traceback

    sys.path[:0] = [str(ROOT)]
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    from meshes.base.errors import InputError

    for line in sys.stdin:
        reader, path, longest_s = json.loads(line)
        faulthandler.dump_traceback_later(longest_s, exit=True)
        try:
            READERS[reader](Path(path))
            told = ("read", "")
        except InputError as problem:
            told = ("refused", str(problem))
        except BaseException as problem:
            last = traceback.extract_tb(problem.__traceback__)[-1]
            told = ("traceback", f"{type(problem).__name__}: {problem} at {last.filename}:{last.lineno}")
        faulthandler.cancel_dump_traceback_later()
        answers.write(json.dumps(told) + "\n")
        answers.flush()


if __name__ == "__main__":
    _serve()
