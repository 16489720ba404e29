"""Picture of a run at a virtual wall."""

from tissue import load_scene, simulate
from tissue.show.figures.force_depth import draw_wall


def test_a_path_wider_than_the_panel_prints_no_warning(tmp_path, caplog):
    changes = {"motion.points_mm": [[0, 0, 4], [0, 0, -2], [60, 0, -2]], "duration_s": 0.7}
    run = simulate(load_scene("wall", changes))
    draw_wall(run, tmp_path / "wall.png")
    assert (tmp_path / "wall.png").is_file()
    assert not caplog.records
