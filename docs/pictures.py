"""Draw the pictures of the guide by the code of its pages: python docs/pictures.py [PAGE ...]

A page's Python and bash run from top to bottom; after each block of Python what it has plotted,
pyvista's scenes and then matplotlib's figures, becomes the next pictures that the page shows.
FOLDER-NAME.png is what a command wrote as FOLDER/NAME.png.

The picture of the page ``validation`` is drawn by tests/validation/report.py.
"""

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

GUIDE = Path(__file__).resolve().parent / "guide"
sys.path.insert(0, str(GUIDE.parent / "_ext"))

from page_code import blocks_of, run_commands  # noqa: E402, next to this file
from PIL import Image  # noqa: E402, what matplotlib writes with

os.environ.update(MPLBACKEND="Agg", PYVISTA_BUILDING_GALLERY="true", PYVISTA_OFF_SCREEN="true")


def plotted() -> Iterator[object]:
    """Yield the plots made since the last call."""
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
    targets = iter(
        [
            page.parent / name
            for name in re.findall(r"^!\[[^\]]*\]\((pictures/[^)]+)\)", text, re.MULTILINE)
        ]
    )
    names: dict[str, object] = {"__name__": "__main__"}
    for language, code in blocks_of(text):
        if language == "bash":
            run_commands(code)
            continue
        exec(compile(code, page.name, "exec"), names)
        for shown in plotted():
            path = next(targets)
            path.parent.mkdir(exist_ok=True)
            if hasattr(shown, "screenshot"):
                shown.screenshot(path)
            else:
                shown.savefig(path, dpi=110)
            print(path)
    left = list(targets)
    for path in list(left):
        written = Path(path.stem.replace("-", "/", 1) + ".png")
        if written.is_file():
            path.parent.mkdir(exist_ok=True)
            with Image.open(written) as picture:
                picture.thumbnail((1200, 900))
                picture.convert("RGB").save(path, optimize=True)
            left.remove(path)
            print(path)
    if left:
        raise SystemExit(
            f"{page.name} must plot all that it shows, got nothing for {left[0].name}: plot it"
        )


def draw_validation() -> None:
    """Draw the picture of measured against predicted forces."""
    script = GUIDE.parents[1] / "tests" / "validation" / "report.py"
    path = GUIDE.parent / "_static" / "validation.png"
    environment = os.environ | {"PYTHONPATH": str(GUIDE.parents[1])}
    subprocess.run([sys.executable, str(script), str(path)], check=True, env=environment)
    print(path)


if __name__ == "__main__":
    asked = sys.argv[1:]
    if not asked or "validation" in asked:
        draw_validation()
    names = [name for name in asked if name != "validation"]
    pages = [GUIDE / f"{name}.md" for name in names]
    if not asked:
        pages = sorted(GUIDE.glob("*.md"))
    wanted = [page for page in pages if "](pictures/" in page.read_text("utf-8")]
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        for page in wanted:
            draw(page)
