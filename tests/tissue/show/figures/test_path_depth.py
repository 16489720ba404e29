"""A toolpath drawn on its bone."""

import numpy as np
import pytest
import trimesh

from meshes.paths.toolpath import Toolpath, depth_along
from meshes.surfaces.surface import surface_from_triangles
from tissue.show.figures.ct_pictures import draw_path_depth


@pytest.mark.slow
def test_a_path_is_drawn_in_the_colours_of_its_depth(tmp_path):
    from PIL import Image

    ball = trimesh.creation.icosphere(4, 25.0)
    surface = surface_from_triangles(np.array(ball.vertices), np.array(ball.faces), scale_mm=1)
    turn = np.linspace(0.0, 6.0 * np.pi, 90)
    spiral = np.column_stack([8 * np.cos(turn), -26.0 + 0.3 * turn, 8 * np.sin(turn)])
    found = depth_along(Toolpath(spiral), surface)
    problem = draw_path_depth(
        surface, found, tmp_path / "path.png", normal=np.array([0.0, -1.0, 0.0]), title="ball"
    )
    if problem is not None:
        pytest.skip(problem)
    with Image.open(tmp_path / "path.png") as picture:
        pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3).astype(int)
    red = (pixels[:, 0] > pixels[:, 2] + 80) & (pixels[:, 0] > 120)
    assert red.sum() > 500
