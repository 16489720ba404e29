"""Text entries of the cache: whole, of this version, or not there."""

from meshes.base.cache import read_entry, write_entry


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
