"""Views of runs, traces, scenes and materials in a notebook, and the pictures they draw."""

import numpy as np
import pytest

import tissue
from meshes.base.errors import InputError


@pytest.fixture(autouse=True)
def closed_figures():
    """No figure of pyplot outlives its test."""
    yield
    from matplotlib import pyplot

    pyplot.close("all")


def test_what_is_shown_is_escaped(run):
    scene = tissue.load_scene("milling").model_copy(update={"description": "<script>"})
    assert "<script>" not in scene._repr_html_() and "&lt;script&gt;" in scene._repr_html_()
    tissue.Run(run)  # a run of its own, for its notes are shared with the fixture's
    run.parts.notes["mine"] = "<b>bold</b>"
    assert "&lt;b&gt;bold" in run._repr_html_()
    del run.parts.notes["mine"]


def test_a_material_shows_value_range_and_source():
    found = tissue.material("enamel")
    assert found["modulus_GPa"].value == 84.1 and "modulus_GPa 84.1" in repr(found)
    table = found.to_pandas()
    assert table.loc["modulus_GPa", "lowest"] == 70.0 and table.columns.name == "enamel"
    assert {"enamel", "bone", "liver"} <= set(tissue.material_names())


def test_a_plot_has_a_panel_for_each_unit_and_marks_events(run):
    panels = run.plot()
    assert [each.get_ylabel() for each in panels] == ["model force / N", "model torque / N m"]
    panels = run.plot(["removed_mm3", "contact_mm2", "removed_cortical_mm3"])
    assert [len(each.lines) for each in panels] == [2, 1]
    drawn = panels[0].lines[0].get_ydata()
    assert np.array_equal(drawn, run.trace["removed_mm3"])
    (alone,) = run.plot("contact_mm2", ax=panels[0])
    assert alone is panels[0]


def test_the_dataset_shows_bone_and_no_box(run):
    image = run.dataset()
    assert image.active_scalars_name == "layer"
    surface = image.extract_surface(algorithm="dataset_surface")
    solid = np.asarray(run.remaining) >= 128
    assert solid.any() and not solid.all()
    faces = sum(
        np.count_nonzero(np.diff(np.pad(solid, 1).astype(int), axis=axis)) for axis in range(3)
    )
    assert surface.n_cells == faces


@pytest.mark.slow
def test_show_draws_a_fresh_run_and_one_read_back(run, back, wall, tmp_path, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    still, other = run.show(0.2), back.show(0.2)
    assert np.array_equal(still, other) and np.std(still) > 10.0
    assert still._repr_png_().startswith(b"\x89PNG") and still.size == (1400, 950)
    assert wall.show(screenshot=tmp_path / "wall.png").size == (1400, 950)
    assert (tmp_path / "wall.png").is_file()
    with pytest.raises(InputError, match="display"):
        run.show(interactive=True)
