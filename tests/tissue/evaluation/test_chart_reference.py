"""Reference forces of charts.

They come from the exact geometry, or from the finest of three grids with its grid-convergence
index.
"""

import numpy as np
import pytest

from tissue.evaluation.charts.measure import grid_force_N, reference_gap
from tissue.evaluation.charts.settings import finest, grids, shares
from tissue.evaluation.reference.history import grid_index
from tissue.scene.load import load_scene

PRESSED = {
    "anatomy.size_mm": [40, 40, 20],
    "anatomy.touch_edge_mm": 8.0,
    "anatomy.nodule_diameter_mm": 0.0,
    "motion.points_mm": [[0, 0, 0.5], [0, 0, -2]],
    "motion.feed_mm_s": 50.0,
}


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


@pytest.mark.slow
def test_where_no_geometry_is_exact_the_reference_is_known_by_the_index(tmp_path, monkeypatch):
    """The reference comes from the index if no geometry is exact.

    For a slab of tetrahedra the finest grid's index belongs to the three forces, and each is
    computed once.
    """
    monkeypatch.setenv("TISSUE_CACHE", str(tmp_path))
    scene = load_scene("palpation", PRESSED)
    gap = reference_gap(scene, quick=True)
    forces = [grid_force_N(scene, each) for each in grids(scene, quick=True)]
    assert len(set(tmp_path.glob("grid-force-*"))) == 3
    assert gap == grid_index(forces, shares(scene, quick=True)).index[-1] and 0.0 < gap < 1.0
