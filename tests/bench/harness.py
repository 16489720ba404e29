"""Percentiles of a repeated call and a description of the machine, for all benchmarks."""

import gc
import os
import platform
import subprocess
import sys
from collections.abc import Callable, Iterable
from importlib.metadata import version
from pathlib import Path
from time import perf_counter

import numpy as np

__all__ = ["Cost", "cost_of", "machine", "table"]

sys.path.append(str(Path(__file__).resolve().parents[1] / "fixtures"))


class Cost:
    """Times of single calls [us]."""

    def __init__(self, times_s: Iterable[float]) -> None:
        self.us = np.asarray(list(times_s)) * 1e6

    @property
    def median(self) -> float:
        """Median [us]."""
        return float(np.median(self.us))

    @property
    def p99(self) -> float:
        """99th percentile [us]."""
        return float(np.percentile(self.us, 99))

    @property
    def worst(self) -> float:
        """Largest [us]."""
        return float(self.us.max())

    def __str__(self) -> str:
        return f"{self.median:8.0f} {self.p99:8.0f} {self.worst:8.0f}"


def cost_of(call: Callable[[int], object], *, count: int, warm_up: int = 50) -> Cost:
    """Time ``call(i)`` for i = 0 ... count - 1; the first ``warm_up`` calls are made but not
    counted.
    """
    times = []
    gc.collect()
    gc.disable()
    try:
        for index in range(count):
            start = perf_counter()
            call(index)
            times.append(perf_counter() - start)
    finally:
        gc.enable()
    return Cost(times[warm_up:])


def machine() -> str:
    """One line on the machine, the versions and the commit."""
    try:
        commit = subprocess.run(
            ["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=True
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        commit = "no commit"
    model = platform.processor() or platform.machine()
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as info:
            model = next(
                line.split(":")[1].strip() for line in info if line.startswith("model name")
            )
    except (OSError, StopIteration):
        pass
    versions = ", ".join(f"{name} {version(name)}" for name in ("numpy", "warp-lang"))
    return (
        f"{model}, {os.cpu_count()} cores, Python {platform.python_version()}, {versions}, {commit}"
    )


def table(rows: list[tuple[str, ...]], head: tuple[str, ...]) -> str:
    """Rows as aligned text."""
    widths = [max(len(row[c]) for row in [head, *rows]) for c in range(len(head))]
    line = lambda row: "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))  # noqa: E731
    return "\n".join([line(head), line(tuple("-" * width for width in widths)), *map(line, rows)])
