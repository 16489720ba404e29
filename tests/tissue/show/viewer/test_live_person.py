"""A person at a live run on a virtual display, whose mouse, wheel and keys move the tool."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from x_events import Person

from tissue.simulation.run_folder import SavedRun

ROOT = Path(__file__).parents[4]
OPTIONS = ("--live", "--no-pictures", "--out")


@pytest.fixture
def started(display, tmp_path):
    """Starts a live run on the display; gives its process and its folder once it ticks."""
    running = []

    def start(*arguments):
        out = tmp_path / "run"
        code = (
            "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\nfrom "
            "tissue.cli.main import main; main()"
        )
        environment = os.environ | {
            "DISPLAY": display,
            "PYTHONPATH": str(ROOT),
            "VTK_DEFAULT_OPENGL_WINDOW": "vtkXOpenGLRenderWindow",
        }
        running.append(
            subprocess.Popen(
                [sys.executable, "-c", code, "run", *arguments, *OPTIONS, str(out)],
                env=environment,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
        )
        last_row(out, running[-1], least=50)
        return running[-1], out

    yield start
    for process in running:
        process.kill()
        process.communicate()


def last_row(out, process, *, least=1):
    """Return the trace's last whole row by column, once it has `least` rows."""
    limit = time.monotonic() + 100.0
    while time.monotonic() < limit:
        if process.poll() is not None:
            message = process.stderr.read()
            if "its window" in message or "OpenGL" in message:
                pytest.skip(f"no window can be opened here: {message[-300:]}")
            raise AssertionError(message)
        if (out / "trace.csv").is_file():
            with (out / "trace.csv").open("rb") as file:
                columns = file.readline().decode().strip().split(",")
                file.seek(max(file.seek(0, os.SEEK_END) - 8000, len(",".join(columns)) + 1))
                lines = file.read().decode().split("\n")[:-1]
            if lines and len(cells := lines[-1].split(",")) == len(columns):
                row = {
                    name: float(cell) for name, cell in zip(columns[:-1], cells[:-1], strict=True)
                }
                if row["time_s"] >= 1e-3 * least:
                    return row
        time.sleep(0.05)
    raise AssertionError(f"{out} did not grow")


def until(out, process, holds, act=lambda: None):
    """Act now and then until the trace's last row holds; that row, or None where it never does."""
    limit = time.monotonic() + 40.0
    while time.monotonic() < limit:
        row = last_row(out, process)
        if holds(row):
            return row
        act()
        time.sleep(0.1)
    return None


@pytest.mark.slow
def test_a_person_presses_the_wall_with_mouse_wheel_and_keys(started, display):
    process, out = started("wall")
    person = Person(display)
    assert last_row(out, process)["tool_z_mm"] == pytest.approx(20.0, abs=0.1)
    pixels = iter(range(400, 800, 5))
    moved = until(
        out, process, lambda row: row["tool_x_mm"] > 5.0, lambda: person.move(next(pixels), 420)
    )
    assert moved is not None, "the mouse does not move the tool"
    height_mm = moved["tool_z_mm"]
    for act in (lambda: person.wheel(1), lambda: person.type("s"), lambda: person.type("Next")):
        lower = until(out, process, lambda row: row["tool_z_mm"] < height_mm - 3.0, act)  # noqa: B023
        assert lower is not None
        height_mm = lower["tool_z_mm"]
    pressed = until(
        out, process, lambda row: row["model_force_z_N"] > 0.5, lambda: person.type("s", 5)
    )
    assert pressed is not None, "the wall is not felt"
    person.type("q")
    person.leave()
    process.communicate(timeout=100.0)
    assert process.returncode == 0
    saved = SavedRun(out)
    assert saved.complete and "live" in saved.summary["notes"]
    assert saved.summary["force_N"]["peak"] > 0.5 and "skipped_ms" in saved.summary
    assert not any("by itself" in event["what"] for event in saved.summary["events"])
