"""The pictures of perception, of an example and of an observer's file."""

import pytest

from tissue.evaluation.charts.perception import perception_charts
from tissue.perception.observer import reference_observer, write_observer


@pytest.mark.slow
def test_pictures_are_drawn_of_an_observer(tmp_path):
    write_observer(reference_observer(), tmp_path / "o.json")
    paths = perception_charts(tmp_path / "charts", tmp_path / "o.json")
    assert [path.name for path in paths] == [
        f"perception-{n}.png" for n in ("people", "command", "deadband")
    ]
    assert all(path.stat().st_size > 50_000 for path in paths)
