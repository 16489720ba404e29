"""Reference forces of charts.

They come from the exact geometry, or from the finest of three grids with its grid-convergence
index.
"""

import numpy as np
import pytest

from tissue.evaluation.charts.settings import finest, grids
from tissue.scene.load import load_scene


@pytest.mark.parametrize("quick", [True, False])
def test_the_grids_of_an_index_change_every_length_alike(quick):
    for name, keys, last in (
        ("glenoid", ("voxels.spacing_mm", "tool.shell_spacing_mm"), 0.5 if quick else 1.0 / 3.0),
        (
            "palpation",
            ("anatomy.touch_edge_mm", "anatomy.edge_mm", "anatomy.edge_growth"),
            0.64 if quick else 0.5,
        ),
    ):
        lengths = np.array(
            [[each[key] for key in keys] for each in grids(load_scene(name), quick=quick)]
        )
        assert lengths[0] == pytest.approx(lengths[2] / last)
        assert np.ptp(lengths / lengths[0], axis=1) == pytest.approx(0.0, abs=1e-12)
    assert (
        grids(load_scene("needle"), quick=quick) == []
        and finest(load_scene("wall"), quick=quick) == {}
    )
