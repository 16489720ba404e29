"""Report in headless Chromium without a network.

It shows a picture, turns, plays, and reports no error.
"""

import io
import shutil

import numpy as np
import pytest

CHROMIUM = (
    shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
)
ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
START_MS = 120_000
"""Longest start of a page [ms], with software rendering and other work on the machine."""
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium: apt-get install chromium"),
]


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as player:
        started = player.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield started
        started.close()


@pytest.fixture
def opened(browser, report_of):
    """Open a report offline; at the end nothing may have been asked for, and no error shown."""
    problems, contexts = [], []

    def page_of(name, **options):
        context = browser.new_context(
            offline=True, viewport={"width": 800, "height": 1000}, **options
        )
        contexts.append(context)
        page = context.new_page()
        file = report_of(name).as_uri()
        page.on(
            "console", lambda each: problems.append(each.text) if each.type == "error" else None
        )
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.on(
            "request",
            lambda asked: (
                None
                if asked.url == file or asked.url.startswith(("data:", "blob:"))
                else problems.append(asked.url)
            ),
        )
        page.goto(file)
        page.wait_for_selector("#stage[data-ready]", timeout=START_MS)
        return page

    yield page_of
    for context in contexts:
        context.close()
    assert not problems


def pixels(page):
    """The 3D view as it is once it no longer changes, shape (rows, columns, 3)."""
    from PIL import Image

    last = None
    for _ in range(60):
        page.wait_for_timeout(150)
        shown = np.asarray(
            Image.open(io.BytesIO(page.locator("#stage").screenshot())).convert("RGB")
        ).astype(int)
        if last is not None and np.array_equal(shown, last):
            return shown
        last = shown
    return last


def changed(before, after):
    """Share of the pixels that differ visibly."""
    return float((np.abs(before - after).max(axis=2) > 12).mean())


def seek(page, share):
    page.locator("#time").evaluate(
        "(slider, to) => { slider.value = to; slider.dispatchEvent(new Event('input')); }",
        10000 * share,
    )


def wait_for_slider(page, least):
    """Wait until the slider has moved.

    The page's policy lets no test evaluate code in it again and again.
    """
    for _ in range(START_MS // 50):
        if int(page.locator("#time").input_value()) > least:
            return
        page.wait_for_timeout(50)
    pytest.fail("the slider does not move")


@pytest.mark.parametrize("name", ["milling", "palpation"])
def test_a_report_shows_turns_and_plays(opened, name):
    page = opened(name)
    assert page.locator("#stage-problem").inner_text() == ""
    first = pixels(page)
    assert changed(first, np.broadcast_to(first[2, 2], first.shape)) > 0.02, "nothing is drawn"
    box = page.locator("#stage").bounding_box()
    x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 150, y + 40, steps=6)
    page.mouse.up()
    turned = pixels(page)
    assert changed(first, turned) > 0.01, "it does not turn"
    page.locator("#reset").click()
    assert changed(first, pixels(page)) < 0.002, "reset does not bring the first view back"
    seek(page, 0.0)
    start = pixels(page)
    seek(page, 1.0)
    assert changed(start, pixels(page)) > 0.001, "the moments look alike"
    seek(page, 0.0)
    page.locator("#play").click()
    wait_for_slider(page, 500)
    page.locator("#play").click()
    assert changed(start, pixels(page)) > 0.0005, "playing changes nothing"
