"""Cache entries: complete and of this version, or computed again."""

import numpy as np

from meshes.base.cache import cached_arrays


def test_arrays_with_a_damaged_header_are_computed_again(tmp_path, monkeypatch):
    monkeypatch.setenv("TISSUE_CACHE", str(tmp_path))
    # A short array would fail its checksum before NumPy parses the header.
    expected = np.arange(20_000.0)

    def make():
        return {"found": expected}

    cached_arrays("test", [1], make)
    (path,) = tmp_path.iterdir()
    whole = path.read_bytes()
    header = whole.rindex(b"\x93NUMPY")
    # NumPy raises TokenError for a header length of 1, and SyntaxError for a comma in a name.
    for place, value in ((8, 1), (21, ord(","))):
        damaged = bytearray(whole)
        damaged[header + place] = value
        path.write_bytes(damaged)
        np.testing.assert_array_equal(cached_arrays("test", [1], make)["found"], expected)
        assert path.read_bytes() == whole


def test_arrays_with_a_damaged_value_or_of_another_version_are_computed_again(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("TISSUE_CACHE", str(tmp_path))
    made = []

    def make():
        made.append(1)
        return {"found": np.array([1.0, 2.5])}

    cached_arrays("test", [1], make)
    cached_arrays("test", [1], make)
    (path,) = tmp_path.iterdir()
    whole = path.read_bytes()
    value = np.array([2.5]).tobytes()
    for damaged in (whole[:-1], whole.replace(value, np.array([3.5]).tobytes()), whole[20:], b""):
        path.write_bytes(damaged)
        assert cached_arrays("test", [1], make)["found"].tolist() == [1.0, 2.5]
    monkeypatch.setattr("meshes.base.cache.package_version", lambda: "0.0.1")
    cached_arrays("test", [1], make)
    assert len(made) == 6
