"""Files that are there whole or not at all."""

import pytest

from meshes.base.whole_file import whole_file


def test_a_file_is_replaced_when_the_new_one_is_whole(tmp_path):
    path, plain = tmp_path / "table.csv", tmp_path / "plain.csv"
    path.write_text("old")
    plain.write_text("plain")
    with whole_file(path) as temporary:
        assert temporary.suffix == ".csv"  # writers of movies and arrays go by it
        temporary.write_text("half")
        assert path.read_text() == "old"
        temporary.write_text("new")
    assert path.read_text() == "new"
    assert path.stat().st_mode == plain.stat().st_mode
    assert set(tmp_path.iterdir()) == {path, plain}


@pytest.mark.parametrize("failure", [OSError, KeyboardInterrupt])
def test_a_writer_that_fails_leaves_the_file_as_it_was(tmp_path, failure):
    path = tmp_path / "table.csv"
    path.write_text("old")
    with pytest.raises(failure), whole_file(path) as temporary:
        temporary.write_text("half")
        raise failure
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]
