"""A trace as pandas, xarray and HTML."""

import numpy as np


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
