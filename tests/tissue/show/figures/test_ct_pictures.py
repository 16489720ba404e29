"""Pictures of a CT: marks at the edge of the image."""

import numpy as np

from meshes.images.frame import Image
from tissue.show.figures import ct_pictures
from tissue.show.figures.ct_pictures import NORMAL_MM, Marks, draw_ct_slices


def test_normal_and_path_outside_of_the_image_are_shown(monkeypatch, tmp_path):
    drawn = []
    monkeypatch.setattr(ct_pictures, "save", lambda chart, path: drawn.append(chart))
    image = Image(np.zeros((10, 12, 14)), (1.0, 1.0, 1.0), "block", ())
    site = np.array([4.0, 5.0, 13.0])
    path = np.array([[4.0, 5.0, 40.0], [4.0, 5.0, 10.0]])
    for points, top in ((None, 13.0 + NORMAL_MM), (path, 40.0)):
        marks = Marks(site, np.array([0.0, 0.0, 1.0]), points)
        draw_ct_slices(image, tmp_path / "slices.png", {}, marks)
        axial, coronal, sagittal = drawn.pop().axes
        assert axial.get_xlim() == (-0.5, 9.5) and axial.get_ylim() == (11.5, -0.5)
        assert coronal.get_ylim() == sagittal.get_ylim() == (-0.5, top)
