"""Open a built site in headless Chromium: python .ci/browse.py docs/_build/html FOLDER

Visits every page at the width of a desktop, and a dozen in the dark and at the width of a phone,
from its server. An error in the console, a request that fails or leaves the site, and a page wider
than its window end it with 1. Writes screenshots into FOLDER. Skips with a reason where playwright
or Chromium is not there.
"""

import functools
import http.server
import os
import shutil
import sys
import threading
from pathlib import Path
from typing import Any

SHOWN = (
    "index",
    "start",
    "guide/index",
    "guide/bone",
    "guide/study",
    "scene_keys",
    "gallery/index",
    "gallery/01_ream_the_glenoid",
    "api/index",
    "api/names/tissue.Bone",
    "performance",
    "extending",
)
"""Pages of which there are pictures; those that are not there are left out."""
VIEWS = {
    "desktop": {"viewport": {"width": 1280, "height": 900}, "color_scheme": "light"},
    "dark": {"viewport": {"width": 1280, "height": 900}, "color_scheme": "dark"},
    "phone": {
        "viewport": {"width": 390, "height": 844},
        "color_scheme": "light",
        "is_mobile": True,
    },
}


class Quiet(http.server.SimpleHTTPRequestHandler):
    """A server that prints nothing."""

    def log_message(self, *words: object) -> None: ...


class Visit:
    """Problems that one tab reports, each with its page and view."""

    def __init__(self, tab: Any, home: str, view: str) -> None:
        self.tab, self.home, self.view, self.page = tab, home, view, ""
        self.found: list[str] = []
        tab.on("console", lambda line: self.report(line.text) if line.type == "error" else None)
        tab.on("pageerror", self.report)
        tab.on("request", lambda request: self.require_inside(request.url))

    def report(self, what: object) -> None:
        """Note a problem of the page that is open."""
        self.found.append(f"{self.page} ({self.view}): {what}")

    def require_inside(self, address: str) -> None:
        """Note a request that leaves the site."""
        if not address.startswith((self.home, "data:", "blob:")):
            self.report(f"asks for {address}")

    def open(self, page: str) -> None:
        """Load a page, named by its path without ``.html``; one that does not open or is too
        wide is noted.
        """
        self.page = page
        answer = self.tab.goto(f"{self.home}{page}.html", wait_until="load")
        if answer is None or not answer.ok:
            self.report("does not open")
        width, shown = self.tab.evaluate(
            "[document.documentElement.scrollWidth, window.innerWidth]"
        )
        if width > shown + 1:
            self.report(f"is {width} wide in a window of {shown}")


def browse(site: Path, out: Path, chromium: str) -> list[str]:
    """Problems of all pages and views."""
    from playwright.sync_api import sync_playwright

    found: list[str] = []
    server = http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), functools.partial(Quiet, directory=str(site))
    )
    threading.Thread(target=server.serve_forever, daemon=True).start()
    pages = sorted(
        path.relative_to(site).with_suffix("").as_posix() for path in site.rglob("*.html")
    )
    pages = [page for page in pages if not page.startswith("_static")]
    with sync_playwright() as playwright:
        options = [
            "--no-sandbox",
            "--disable-gpu",
            "--disable-background-networking",
            "--no-first-run",
        ]
        browser = playwright.chromium.launch(executable_path=chromium, args=options)
        for view, context in VIEWS.items():
            tab = browser.new_context(**context).new_page()
            visit = Visit(tab, f"http://127.0.0.1:{server.server_port}/", view)
            for page in pages if view == "desktop" else [page for page in SHOWN if page in pages]:
                visit.open(page)
                if page in SHOWN:
                    tab.screenshot(
                        path=out / f"{page.replace('/', '-')}-{view}.png", full_page=view == "phone"
                    )
            found += visit.found
        browser.close()
    server.shutdown()
    return found


def main() -> None:
    """Visit the site that the command names, print its problems and exit with 1 where there are
    any.
    """
    site, out = Path(sys.argv[1]).resolve(), Path(sys.argv[2])
    chromium = (
        os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
    )
    try:
        import playwright  # noqa: F401
    except ImportError:
        return print("skipped: playwright is not installed")
    if chromium is None:
        return print("skipped: there is no Chromium")
    out.mkdir(parents=True, exist_ok=True)
    wrong = browse(site, out, chromium)
    print("\n".join(wrong) or f"no page reports an error; screenshots in {out}")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
