"""Cache entries: complete and of this version, or computed again."""

import numpy as np

from meshes.base.cache import cached_arrays, read_entry, write_entry


def test_a_text_entry_is_kept_whole_or_not_at_all(tmp_path, monkeypatch):
    path = tmp_path / "deep" / "entry.csv"
    text = "a,b\r\n1,2.5\r\n3,µ\r\n"
    assert read_entry(path) is None
    write_entry(path, text)
    assert read_entry(path) == text
    whole = path.read_bytes()
    for damaged in (whole[:-1], whole.replace(b"2.5", b"3.5"), whole[20:], b"\xff" + whole, b""):
        path.write_bytes(damaged)
        assert read_entry(path) is None
    path.write_bytes(whole)
    monkeypatch.setattr("meshes.base.cache.package_version", lambda: "0.0.1")
    assert read_entry(path) is None


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
