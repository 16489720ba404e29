"""Draw the pictures of the guide by the code of its pages: python docs/pictures.py [PAGE ...]

A page's Python runs from top to bottom; after each block what it has plotted, pyvista's scenes and then matplotlib's
figures, becomes the next pictures that the page shows.
"""

import os
import re
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

GUIDE = Path(__file__).resolve().parent / "guide"
os.environ.update(MPLBACKEND="Agg", PYVISTA_BUILDING_GALLERY="true", PYVISTA_OFF_SCREEN="true")


def plotted() -> Iterator[object]:
    """What was plotted since the last call."""
    import pyvista
    from matplotlib import pyplot
    from pyvista.plotting.plotter import _ALL_PLOTTERS

    yield from list(_ALL_PLOTTERS.values())
    pyvista.close_all()
    for number in pyplot.get_fignums():
        yield pyplot.figure(number)
    pyplot.close("all")


def draw(page: Path) -> None:
    """Run a page and write its pictures."""
    text = page.read_text("utf-8")
    targets = iter([page.parent / name for name in re.findall(r"^!\[[^\]]*\]\((pictures/[^)]+)\)", text, re.MULTILINE)])
    names: dict[str, object] = {"__name__": "__main__"}
    for code in re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        exec(compile(code, page.name, "exec"), names)
        for shown in plotted():
            path = next(targets)
            path.parent.mkdir(exist_ok=True)
            if hasattr(shown, "screenshot"):
                shown.screenshot(path)
            else:
                shown.savefig(path, dpi=110)
            print(path)
    if left := list(targets):
        raise SystemExit(f"{page.name} must plot all that it shows, got nothing for {left[0].name}: plot it")


if __name__ == "__main__":
    pages = [GUIDE / f"{name}.md" for name in sys.argv[1:]] or sorted(GUIDE.glob("*.md"))
    wanted = [page for page in pages if "](pictures/" in page.read_text("utf-8")]
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        for page in wanted:
            draw(page)
