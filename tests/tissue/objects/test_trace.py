"""A trace as pandas, xarray and HTML."""

import sys

import numpy as np
import pandas
import pytest

from tissue import InputError
from tissue.simulation.saved_fields import field_label
from tissue.simulation.trace import Table


def test_pandas_takes_the_trace_itself_as_a_table(run):
    table = pandas.DataFrame(run.trace)
    assert tuple(table.columns) == run.trace.columns and len(table) == len(run.trace.rows)
    assert np.array_equal(table["force_z_N"], run.trace["force_z_N"])
    assert isinstance(run.trace, Table) and run.trace.vectors("force", "N").shape == (len(table), 3)


def test_to_pandas_has_time_as_a_column_and_layers_as_categories(run):
    table = run.to_pandas()
    assert "time_s" in table and table.index.name == "tick" and table.attrs == {"scene": "milling"}
    assert list(table["layer"].cat.categories) == ["cortical", "none"]
    assert np.array_equal(table["force_z_N"].to_numpy(), run.trace["force_z_N"])
    assert run.timing.to_pandas().index.name == "tick"


def test_to_xarray_has_units(run):
    found = run.to_xarray()
    assert dict(found.sizes) == {"time_s": 300} and found.attrs == {"scene": "milling"}
    assert found["force_z_N"].attrs == {"long_name": "force z", "units": "N"}
    assert found["time_s"].attrs["units"] == "s"
    assert np.array_equal(found["removed_mm3"], run.trace["removed_mm3"])


@pytest.mark.parametrize("name", ["run", "wall"])
def test_every_column_with_a_unit_is_known(name, request):
    run = request.getfixturevalue(name)
    without = {column for column in run.trace if not field_label(column)[1]}
    plain = {"tool_qx", "tool_qy", "tool_qz", "tool_qw", "layer"}
    assert plain <= without and not {each for each in without - plain if each[-1:].isupper()}
    assert field_label("velocity_x_mm_s") == ("velocity x", "mm/s")


def test_an_unknown_column_is_named(run):
    with pytest.raises(KeyError, match="'force_q_N' is not a column; known: time_s, "):
        run.trace["force_q_N"]


def test_html_has_units_and_is_short(run):
    html = run.trace._repr_html_()
    assert "force z / N" in html and html.count("<tr>") == 12 and "300 ticks" in html


def test_a_missing_library_is_named_with_its_line(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=r"tissue-sim\[pandas\]"):
        run.trace.to_pandas()
