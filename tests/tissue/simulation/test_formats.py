"""The trace in each further format, read back by that format's own reader."""

import numpy as np
import pytest

from tissue.simulation.trace import FORMATS, Table, TraceLayout, write_table

LAYERS = ("subchondral_bone", "trabecular")


@pytest.fixture(scope="module")
def trace():
    columns = TraceLayout.of(LAYERS).columns
    random = np.random.default_rng(5)
    rows = random.normal(size=(70, len(columns)))
    rows[:, -1] = random.integers(-1, len(LAYERS), 70)
    return Table(columns, rows, LAYERS)


def _parquet(path):
    table = pytest.importorskip("pyarrow.parquet").read_table(path)
    return {name: np.array(table[name].to_pylist()) for name in table.column_names}


def _npz(path):
    with np.load(path, allow_pickle=False) as file:
        return dict(file)


def _mat(path):
    from scipy.io import loadmat

    record = loadmat(path, squeeze_me=True, struct_as_record=True)["trace"][()]
    return {name: np.array(list(record[name])) for name in record.dtype.names}


def _h5(path):
    with pytest.importorskip("h5py").File(path) as file:
        return {
            name: file[name].asstr()[:] if file[name].dtype.kind in "SO" else file[name][:]
            for name in file
        }


READERS = {"parquet": _parquet, "npz": _npz, "mat": _mat, "h5": _h5}


@pytest.mark.parametrize("kind", FORMATS)
def test_a_format_reads_back_equal(trace, tmp_path, kind):
    path = tmp_path / f"trace.{kind}"
    write_table(trace, path)
    assert path == tmp_path / f"trace.{kind}"
    back = READERS[kind](path)
    assert set(back) == set(trace.columns)
    for name in trace:
        np.testing.assert_array_equal(back[name], trace[name], err_msg=name)
    assert set(back["layer"]) == {*LAYERS, "none"}
