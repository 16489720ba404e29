"""Run the tests that guard a module on a copy of the code with one planted error."""

import importlib
import json
import os
import resource
import shutil
import signal
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from mutant_operators import Mutant

__all__ = ["PACKAGES", "Runs", "Tree", "Verdict", "file_of", "preload"]

PACKAGES = ("kernels", "meshes", "tissue")
PRELOADED = (
    "numpy",
    "scipy.sparse.linalg",
    "scipy.spatial.transform",
    "scipy.special",
    "scipy.optimize",
    "scipy.interpolate",
    "scipy.stats",
    "scipy.signal",
    "scipy.ndimage",
    "scipy.integrate",
    "warp",
    "pydantic",
    "pytest",
    "xdist",
    "pytest_timeout",
    "skimage.measure",
    "trimesh",
    "pyamg",
    "threadpoolctl",
    "psutil",
    "matplotlib.pyplot",
    "rich",
    "pyvista",
    "tomli_w",
    "skfem",
    "statsmodels.api",
)
"""Modules that are imported once, before any process is forked."""
CODE_ERRORS = ("codegen.py", "WarpCodegen", "kernel build failed")
"""Marks of kernels that do not compile: such a mutant shows nothing about the tests."""
POLL_S = 0.02
LONGEST_WALL = 8.0
"""Wall time after which a process is stopped, over its limit of processor time."""


@dataclass(frozen=True)
class Verdict:
    """Result of one run of tests.

    Attributes
    ----------
    outcome
        ``passed``, ``failed``, ``timeout``, ``crashed``, ``void`` or ``no tests``.
    test
        First test that failed, as pytest names it.
    """

    outcome: str
    test: str = ""


def preload() -> None:
    """Import what is slow to import, with one thread for linear algebra, and start Warp."""
    for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[threads] = "1"
    for name in PRELOADED:
        with suppress(ImportError):
            importlib.import_module(name)
    import warp

    warp.config.log_level = warp.LOG_ERROR
    # Warp's native part reports a missing GPU on standard error, whatever the level.
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    warp.init()
    os.dup2(kept, 2)
    os.close(kept)
    os.close(nowhere)


def file_of(module: str, root: Path) -> Path | None:
    """File of a module below a folder, None if there is none."""
    base = root.joinpath(*module.split("."))
    for path in (base.with_suffix(".py"), base / "__init__.py"):
        if path.is_file():
            return path
    return None


class Tree:
    """Scratch copy of the code and its tests, in which one error at a time is planted."""

    def __init__(self, source: Path, folder: Path) -> None:
        self.root = folder / "tree"
        for name in (*PACKAGES, "tests"):
            shutil.copytree(
                source / name, self.root / name, ignore=shutil.ignore_patterns("__pycache__")
            )
        shutil.copy2(source / "pyproject.toml", self.root)
        shared = source.parent / "shared"
        if shared.is_dir():
            (folder / "shared").symlink_to(shared)
        self._stamp = 1_000_000_000
        self._restore: Callable[[], None] | None = None

    def plant(self, mutant: Mutant) -> None:
        """Write a module with an error."""
        path = file_of(mutant.module, self.root)
        assert path is not None
        source, status = path.read_text(), path.stat()

        def restore() -> None:
            path.write_text(source)
            os.utime(path, (status.st_mtime, status.st_mtime))

        self._restore = restore
        path.write_text(mutant.applied(source))
        # Python compares the compiled module with its source by whole seconds and size only.
        self._stamp += 10
        os.utime(path, (self._stamp, self._stamp))

    def clear(self) -> None:
        """Take the error out again."""
        if self._restore is not None:
            self._restore()
        self._restore = None


class _Watch:
    """Pytest plugin: recent killers first, and a note of the first failure."""

    def __init__(self, first: Sequence[str]) -> None:
        self.first = {name: at for at, name in enumerate(first)}
        self.failures: list[tuple[str, str]] = []

    def pytest_collection_modifyitems(self, items: list) -> None:
        """Bring the tests that caught the last errors to the front."""
        items.sort(key=lambda item: self.first.get(item.nodeid, len(self.first)))

    def pytest_runtest_logreport(self, report: object) -> None:
        """Note a failed test."""
        self._note(report)

    def pytest_collectreport(self, report: object) -> None:
        """Note a test file that cannot be imported."""
        self._note(report)

    def _note(self, report: object) -> None:
        if report.failed:
            self.failures.append((report.nodeid, str(report.longrepr)))


class _Child:
    """Forked process that runs pytest in a tree."""

    def __init__(
        self, tree: Tree, tests: Sequence[str], first: Sequence[str], *, stop: bool, limit_s: float
    ) -> None:
        self.work = tree.root.parent / f"run-{time.monotonic_ns()}"
        self.work.mkdir()
        self._limit_s, self._started = limit_s, time.monotonic()
        self._timed_out = False
        self.pid = os.fork()
        if self.pid == 0:
            try:
                code = self._inside(tree, tests, first, stop)
            except BaseException:
                code = 99
            os._exit(code)

    def _inside(self, tree: Tree, tests: Sequence[str], first: Sequence[str], stop: bool) -> int:
        """Run the tests in the forked process and write down the failures."""
        import pytest

        os.setsid()
        resource.setrlimit(resource.RLIMIT_CPU, (int(self._limit_s), int(self._limit_s) + 5))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        output = os.open(self.work / "output.txt", os.O_WRONLY | os.O_CREAT)
        os.dup2(output, 1)
        os.dup2(output, 2)
        os.chdir(tree.root)
        os.environ["TISSUE_CACHE"] = str(self.work / "cache")
        os.environ["PYTHONPATH"] = str(tree.root)
        sys.path[:] = [
            str(tree.root),
            *(each for each in sys.path if each and Path(each) != Path(__file__).parent),
        ]
        observer = _Watch(first)
        options = [
            "-p",
            "no:cacheprovider",
            "--basetemp",
            str(self.work / "tmp"),
            *(["-x"] if stop else []),
        ]
        code = int(pytest.main([*options, *tests], plugins=[observer]))
        (self.work / "failures.json").write_text(json.dumps(observer.failures))
        return code

    def ended(self) -> bool:
        """Return True if the process has ended, and stop a process that takes too long."""
        pid, status = os.waitpid(self.pid, os.WNOHANG)
        if pid:
            self._code = os.waitstatus_to_exitcode(status)
            return True
        if time.monotonic() - self._started > LONGEST_WALL * self._limit_s and not self._timed_out:
            self._timed_out = True
            with suppress(ProcessLookupError):
                os.killpg(self.pid, signal.SIGKILL)
        return False

    def failures(self) -> list[tuple[str, str]]:
        """Tests that failed, each with its report."""
        path = self.work / "failures.json"
        return (
            [(name, text) for name, text in json.loads(path.read_text())] if path.is_file() else []
        )

    def verdict(self) -> Verdict:
        """Return the verdict on the run."""
        failures = self.failures()
        if self._timed_out or self._code == -signal.SIGXCPU:
            return Verdict("timeout")
        if failures:
            name, text = failures[0]
            return Verdict("void" if any(mark in text for mark in CODE_ERRORS) else "failed", name)
        if self._code == 0:
            return Verdict("passed")
        return Verdict("no tests" if self._code == 5 else "crashed")


class Runs:
    """Runs of guarding tests, several at once, each in a tree of its own."""

    def __init__(self, source: Path, folder: Path, *, workers: int, limit_s: float) -> None:
        self.limit_s = limit_s
        self._free = [Tree(source, folder / f"worker-{at}") for at in range(workers)]
        self._busy: list[tuple[_Child, Tree, Callable[[Verdict], None]]] = []

    def start(
        self,
        mutant: Mutant,
        tests: Sequence[str],
        first: Sequence[str],
        done: Callable[[Verdict], None],
    ) -> None:
        """Run the tests on a mutant as soon as a tree is free, and hand the verdict to ``done``."""
        while not self._free:
            self._poll()
        tree = self._free.pop()
        tree.plant(mutant)
        self._busy.append((_Child(tree, tests, first, stop=True, limit_s=self.limit_s), tree, done))

    def wait(self) -> None:
        """Wait for all runs."""
        while self._busy:
            self._poll()

    def failing(self, tests: Sequence[str], *, limit_s: float) -> list[str]:
        """Tests that fail, or run out of time, on the code without any error."""
        self.wait()
        child = _Child(self._free[-1], tests, [], stop=False, limit_s=limit_s)
        while not child.ended():
            time.sleep(POLL_S)
        failed = [name for name, _ in child.failures()]
        verdict = child.verdict()
        return failed or (
            [] if verdict.outcome == "passed" else [f"{verdict.outcome}: {' '.join(tests)}"]
        )

    def _poll(self) -> None:
        time.sleep(POLL_S)
        for entry in list(self._busy):
            child, tree, done = entry
            if child.ended():
                self._busy.remove(entry)
                tree.clear()
                verdict = child.verdict()
                shutil.rmtree(child.work, ignore_errors=True)
                self._free.append(tree)
                done(verdict)
