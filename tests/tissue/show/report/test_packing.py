"""Arrays come back from their text as `decode.js` reads it, here in NumPy."""

import zlib
from base64 import b64decode

import numpy as np
import pytest

from tissue.show.report.charts import (
    packed,
    packed_mesh,
    packed_vectors,
)


def unpacked(record):
    kind = np.dtype(record["kind"]).newbyteorder("<")
    steps = np.frombuffer(zlib.decompress(b64decode(record["data"])), kind)
    steps = steps.reshape(record["columns"], record["rows"])
    return np.cumsum(steps, axis=1, dtype=np.int64).T.astype(record["kind"])


def numbers(record):
    return np.array(record["low"]) + record["step"] * (unpacked(record).astype(float) + 32767)


@pytest.mark.parametrize("kind", [np.uint8, np.int16, np.int32])
def test_whole_numbers_come_back_exactly(kind):
    ends = np.iinfo(kind)
    rng = np.random.default_rng(4)
    values = rng.integers(ends.min, ends.max, (200, 3), endpoint=True).astype(kind)
    values[:2] = [[ends.min] * 3, [ends.max] * 3]
    assert np.array_equal(unpacked(packed(values)), values)


def test_numbers_come_back_within_half_a_step_and_zero_exactly():
    rng = np.random.default_rng(5)
    values = rng.normal(0.0, [1.0, 40.0, 1e-3], (500, 3))
    values[7] = 0.0
    record = packed_vectors(values)
    back = numbers(record)
    assert record["step"] < 1.001 * np.ptp(values, axis=0).max() / 65532
    assert np.abs(back - values).max() <= 0.5001 * record["step"]
    assert (back[7] == 0.0).all()


@pytest.mark.parametrize("values", [np.zeros(0), np.full(4, 3.25), np.array([-2.0])])
def test_columns_that_do_not_vary_come_back(values):
    back = numbers(packed_vectors(values[:, None])).ravel()
    assert back == pytest.approx(values, rel=1.6e-5)  # 1/65532


def test_a_mesh_keeps_its_points_and_triangles():
    rng = np.random.default_rng(6)
    points, triangles = rng.normal(size=(40, 3)), rng.integers(0, 40, (80, 3))
    record = packed_mesh(points, triangles)
    assert np.array_equal(unpacked(record["corners"]), triangles)
    assert np.abs(numbers(record["points"]) - points).max() <= record["points"]["step"]
