"""A notebook that a kernel runs: a run shows itself, its plot, a still picture and a bar."""

import pytest

pytestmark = pytest.mark.slow
CELLS = (
    (
        "import tissue\nrun = tissue.simulate(tissue.load_scene('milling', {'voxels.spacing_mm': "
        "0.4, 'duration_s': 0.3}))"
    ),
    "run",
    "run.scene",
    "run.trace",
    "run.plot();",
    "run.show(interactive=False)",
    "tissue.material('enamel')",
)


@pytest.fixture(scope="module")
def outputs():
    """Output of each cell."""
    nbclient = pytest.importorskip(
        "nbclient", reason="nbclient is not installed: pip install -e '.[dev]'"
    )
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in CELLS])
    nbclient.NotebookClient(book, timeout=240, kernel_name="python3").execute()
    return dict(zip(CELLS, (cell["outputs"] for cell in book.cells), strict=True))


def of(outputs, cell):
    """Return the outputs of a cell by kind.

    Lines on standard error come from the graphics library and are left out.
    """
    shown = [each for each in outputs[cell] if each["output_type"] != "stream"]
    return {kind: each["data"][kind] for each in shown for kind in each["data"]}


@pytest.mark.parametrize(
    ("cell", "words"),
    [
        ("run", "run of milling"),
        ("run.scene", "spacing_mm"),
        ("run.trace", "force z / N"),
        (CELLS[-1], "PMC"),
    ],
)
def test_what_is_held_shows_itself(outputs, cell, words):
    assert words in of(outputs, cell)["text/html"]


@pytest.mark.parametrize("cell", ["run.plot();", "run.show(interactive=False)"])
def test_pictures_are_shown_once(outputs, cell):
    assert len(of(outputs, cell)["image/png"]) > 5000
    assert sum("image/png" in each.get("data", ()) for each in outputs[cell]) == 1
