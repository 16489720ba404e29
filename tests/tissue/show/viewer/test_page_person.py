"""A person at the pages of live and saved runs, in headless Chromium."""

import os
import re
import shutil
import subprocess
import sys
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from tissue.simulation.run_folder import SavedRun

ROOT = Path(__file__).parents[4]
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
SLOW_MS = 60_000.0
"""Longest time to wait for anything on a page [ms], with a margin for a busy machine."""
pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


@pytest.fixture(scope="module")
def browser():
    """Headless Chromium."""
    pytest.importorskip("aiohttp")
    sync_api = pytest.importorskip("playwright.sync_api")
    chromium = (
        os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
    )
    if chromium is None:
        pytest.skip("there is no Chromium: apt-get install chromium")
    with sync_api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=chromium, args=list(FLAGS))
        yield opened
        opened.close()


class Person:
    """Somebody at a page."""

    def __init__(self, tab, home):
        self.tab, self.wrong = tab, []
        tab.on(
            "console", lambda line: self.wrong.append(line.text) if line.type == "error" else None
        )
        tab.on("pageerror", lambda error: self.wrong.append(str(error)))
        tab.on(
            "request",
            lambda asked: (
                None if asked.url.startswith((home, "data:")) else self.wrong.append(asked.url)
            ),
        )
        tab.set_default_timeout(SLOW_MS)

    def number(self, name):
        """The first number in an element."""
        return float(
            re.search(r"[−-]?[\d.]+", self.tab.text_content(f"#{name}")).group().replace("−", "-")
        )

    def until(self, holds, act=lambda: None, *, tries=200):
        """Act now and then until something holds; whether it did."""
        for _ in range(tries):
            if holds():
                return True
            act()
            self.tab.wait_for_timeout(100)
        return False

    def state(self, words):
        """Wait for a state of the run."""
        self.tab.wait_for_function(
            "words => document.getElementById('state').textContent === words", arg=words
        )

    def picture(self):
        """Return a picture of the scene as drawn, shape (height, width, 3)."""
        from PIL import Image

        with Image.open(BytesIO(self.tab.locator("#picture").screenshot())) as image:
            return np.asarray(image.convert("RGB"), dtype=int)


@pytest.fixture
def opened(browser, tmp_path):
    """Starts a command that prints an address; gives a person at its page, and the process."""
    started = []

    def start(*arguments):
        environment = {k: v for k, v in os.environ.items() if k != "DISPLAY"} | {
            "PYTHONPATH": str(ROOT)
        }
        command = [sys.executable, "-u", "-m", "tissue", *map(str, arguments), "--web"]
        pipe = subprocess.PIPE
        process = subprocess.Popen(
            command, env=environment, stdout=pipe, stderr=subprocess.STDOUT, text=True
        )
        started.append(process)
        printed = []
        for line in process.stdout:
            printed.append(line)
            if found := re.search(r"open (http://127\.0\.0\.1:\d+/)(\?token=[\w-]{32})", line):
                break
        else:
            if "OpenGL" in "".join(printed):
                pytest.skip(f"nothing can be drawn here: {printed[-1]}")
            raise AssertionError("".join(printed))
        person = Person(
            browser.new_context(viewport={"width": 1280, "height": 800}).new_page(), found[1]
        )
        person.tab.goto(found[1] + found[2])
        return person, process

    yield start
    for process in started:
        process.kill()
        process.communicate()


def live(opened, out, *arguments):
    """A person at a live run, which has begun."""
    person, process = opened("run", *arguments, "--live", "--no-pictures", "--out", out)
    person.state("running")
    assert person.until(lambda: person.number("time") > 0.0)
    return person, process


def is_drawn(picture):
    """Return True if a picture shows more than its white background."""
    return 0.02 < (picture.min(axis=2) < 240).mean() < 0.98 and picture.std() > 10.0


def test_a_person_presses_the_wall_pauses_and_begins_again(opened, tmp_path):
    person, process = live(opened, tmp_path / "run", "wall")
    assert person.until(lambda: is_drawn(person.picture()))
    assert person.number("force") == 0.0
    mouse = person.tab.mouse
    mouse.move(400, 420)
    assert person.until(lambda: person.number("force") > 0.5, lambda: mouse.wheel(0, 200)), (
        "the wheel does not press"
    )
    before = person.number("force")
    mouse.down()
    places = iter(range(420, 900, 2))
    assert person.until(
        lambda: abs(person.number("force") - before) > 0.2, lambda: mouse.move(400, next(places))
    ), "a drag does not change the force"
    mouse.up()

    seen = person.picture()
    person.tab.keyboard.down("Shift")
    mouse.move(400, 420)
    mouse.down()
    mouse.move(480, 380, steps=4)
    mouse.up()
    person.tab.keyboard.up("Shift")
    assert person.until(lambda: np.abs(person.picture() - seen).mean() > 2.0), (
        "shift and a drag do not turn the view"
    )

    person.tab.click("#pause")
    person.state("paused")
    assert person.until(lambda: still(person, "time")), "time continues in a pause"
    before = person.number("time"), person.number("force")
    mouse.move(400, 420)
    mouse.wheel(0, 500)
    person.tab.wait_for_timeout(1000)
    assert (person.number("time"), person.number("force")) == before
    person.tab.click("#pause")
    person.state("running")
    assert person.until(lambda: person.number("time") > before[0])

    person.tab.click("#reset")
    assert person.until(lambda: person.number("force") == 0.0 and person.number("time") > 0.0)
    person.tab.click("#end")
    output, _ = process.communicate(timeout=200.0)
    assert process.returncode == 0, output
    person.state("ended")
    assert person.tab.is_disabled("#pause")
    saved = SavedRun(tmp_path / "run")
    assert saved.complete and saved.trace["time_s"][0] == 0.0
    assert saved.summary["force_N"]["peak"] == 0.0 and "live" in saved.summary["notes"]
    assert "skipped_ms" in saved.summary and person.wrong == []


def test_a_tooth_is_cut_open_and_the_layer_at_the_bur_is_shown(opened, tmp_path):
    coarse = ("--set", "voxels.spacing_mm=0.2", "--set", "stress.cell_mm=0.8")
    person, process = live(opened, tmp_path / "run", "molar", *coarse)
    tab = person.tab
    assert person.until(lambda: is_drawn(person.picture()))
    assert tab.text_content("#cut") == "Close" and tab.text_content("#layer") == "none"
    opened_tooth = person.picture()
    tab.click("#cut")
    assert tab.text_content("#cut") == "Cut open"
    assert person.until(lambda: np.abs(person.picture() - opened_tooth).mean() > 1.0), (
        "the tooth is not closed"
    )
    tab.mouse.move(400, 420)
    assert person.until(
        lambda: tab.text_content("#layer") == "enamel", lambda: tab.mouse.wheel(0, 50)
    ), "the layer is not shown"
    tab.click("#end")
    output, _ = process.communicate(timeout=200.0)
    assert process.returncode == 0, output


def test_end_is_accepted_before_the_first_picture(opened, tmp_path):
    person, process = opened("run", "wall", "--live", "--no-pictures", "--out", tmp_path / "run")
    person.tab.click("#end")
    output, _ = process.communicate(timeout=200.0)
    assert process.returncode in (0, 130), output
    person.state("ended")


def still(person, name):
    """Return True if a number does not change for half a second."""
    before = person.number(name)
    person.tab.wait_for_timeout(500)
    return person.number(name) == before


def test_a_person_looks_at_a_saved_run(opened, layered, tmp_path):
    person, process = opened("view", layered)
    tab = person.tab
    tab.wait_for_function("() => document.getElementById('shown').options.length > 2")
    assert person.until(lambda: is_drawn(person.picture()))
    saved = SavedRun(layered)
    peak = float(np.linalg.norm(saved.trace.vectors("model_force", "N"), axis=1).max())
    assert person.until(lambda: person.number("force") == pytest.approx(peak, abs=0.006))
    at_peak = person.picture()
    tab.locator("#slider").evaluate(
        "bar => { bar.value = 0; bar.dispatchEvent(new Event('input')); }"
    )
    tab.locator("#slider").evaluate("bar => bar.dispatchEvent(new Event('change'))")
    assert person.until(lambda: person.number("force") == 0.0 and person.number("removed") == 0.0)
    assert person.until(lambda: np.abs(person.picture() - at_peak).mean() > 1.0), (
        "the bone of the moment is not drawn"
    )
    tab.select_option("#shown", "von_mises_MPa")
    assert person.until(lambda: np.abs(person.picture() - at_peak).mean() > 1.0)
    tab.select_option("#shown", "layer")
    tab.wait_for_timeout(2000)
    before = person.picture()
    tab.locator("#legend input").first.click()
    assert person.until(lambda: np.abs(person.picture() - before).mean() > 1.0), (
        "a layer is not switched off"
    )
    tab.click("#play")
    assert person.until(lambda: person.number("time") > 0.1)
    person.state("paused")
    box = tab.locator("#plot").bounding_box()
    tab.mouse.click(box["x"] + 58 + 0.5 * (box["width"] - 70), box["y"] + 100)
    last = float(saved.trace["time_s"][-1])
    assert person.until(lambda: person.number("time") == pytest.approx(0.5 * last, abs=0.02))
    tab.click("#end")
    output, _ = process.communicate(timeout=100.0)
    assert process.returncode == 0 and "N, torque up to" in output
    assert person.wrong == []
