"""Fields of a saved run on tetrahedra.

The tests cover names, scales over time, the mesh between two frames, and the drawn part.
"""

import numpy as np
import pytest
from fake_fields import PARTS, block_series, depth_at, pressed_run, pressed_series
from recording_plotter import RecordingPlotter

from tissue.fem.fields import FieldSeries, Frame
from tissue.show.viewer.fields import FieldsShown
from tissue.simulation.saved_fields import SavedFields
from tissue.simulation.vtk_files import write_fields

ROUNDING = 1e-5
"""Share by which single precision, in which fields are written, may be off."""


@pytest.fixture(scope="module")
def pressed(tmp_path_factory):
    """Folder of a run that pressed a soft box by 6 mm within a second."""
    return pressed_run(tmp_path_factory.mktemp("runs") / "press")


def test_a_scale_spans_the_whole_run(pressed):
    fields = SavedFields(pressed)
    assert fields.names == [
        "von_mises_kPa",
        "principal_1_kPa",
        "max_principal_strain_percent",
        "displacement_mm",
        "reaction_N",
    ]
    assert (fields.layer_names, fields.displacement, fields.unit_mm) == (
        PARTS,
        "displacement_mm",
        1.0,
    )
    series = pressed_series()
    low, high = fields.limits("von_mises_kPa")
    peak = max(float(np.percentile(frame.cells["von_mises_kPa"], 99.8)) for frame in series.frames)
    assert high == pytest.approx(peak, rel=ROUNDING) and 0.0 < low <= 0.1 * high
    low, high = fields.limits("principal_1_kPa")
    assert low == -high < 0.0
    assert fields.limits("displacement_mm") == (0.0, pytest.approx(6.0, rel=ROUNDING))
    assert fields.largest_mm() == pytest.approx(6.0, rel=ROUNDING)


def test_between_two_frames_of_one_mesh_values_are_interpolated(pressed):
    fields = SavedFields(pressed)
    for time in (0.2, 0.35, 0.5, 0.62, 1.0):
        mesh, shown = fields.at(time)
        assert shown == pytest.approx(time)
        # The box moves in proportion to the depth, which is linear in time between 0.2 and 1 s.
        assert np.linalg.norm(fields.moved_mm(mesh), axis=1).max() == pytest.approx(
            depth_at(time, 1.0, 6.0), abs=1e-5
        )
    # Asking for a moment leaves the frames as they were.
    assert np.linalg.norm(fields.moved_mm(fields.frames[5]), axis=1).max() == pytest.approx(
        2.25, rel=ROUNDING
    )
    assert fields.at(7.0)[1] == 1.0


def test_where_cells_have_gone_the_earlier_frame_is_kept(tmp_path):
    write_fields(block_series((-8e-3, -8e-3, -8e-3), (8e-3, 8e-3, 0.0), (4, 4, 3)), tmp_path)
    fields = SavedFields(tmp_path)
    mesh, shown = fields.at(0.2)
    assert shown == 0.1 and mesh.n_cells == 4 * 4 * 3 - 1
    assert fields.moved_mm(mesh).max() == pytest.approx(8e-3 * 0.1, rel=ROUNDING)  # µm


def _affine(tmp_path, gradient):
    """Return fields of a box that is deformed alike everywhere.

    One frame is at rest and one deformed.
    """
    series = pressed_series((4, 4, 2), frames=2)
    still, last = series.frames
    moved = (1e3 * series.nodes_m @ gradient.T).astype(np.float32)
    frames = [
        Frame(0.0, still.points | {"displacement_mm": 0.0 * moved}, still.cells),
        Frame(1.0, last.points | {"displacement_mm": moved}, last.cells),
    ]
    write_fields(
        FieldSeries(series.nodes_m, series.cells, series.layer, series.layer_names, frames),
        tmp_path,
    )
    return SavedFields(tmp_path), frames[1]


def test_deformed_cut_and_without_a_part(tmp_path):
    gradient = np.diag((0.0, 0.5, 0.0))
    fields, _ = _affine(tmp_path, gradient)
    plotter = RecordingPlotter()
    shown = FieldsShown(plotter, fields)
    shown.show("displacement_mm")
    shown.at(1.0)
    drawn = lambda: plotter.meshes["field"][0]  # noqa: E731
    assert drawn().bounds[2:4] == pytest.approx((-30.0, 30.0), rel=ROUNDING)
    shown.enlarge(2.0)
    assert drawn().bounds[2:4] == pytest.approx((-40.0, 40.0), rel=ROUNDING)
    shown.cut(((0.0, -1.0, 0.0), (0.0, 10.0, 0.0)))
    assert drawn().bounds[2:4] == pytest.approx((10.0, 40.0), rel=ROUNDING)
    shown.hide(frozenset({"capsule"}))
    assert drawn().bounds[5] == pytest.approx(-10.0, rel=ROUNDING)
    assert set(drawn().cell_data["layer"]) == {PARTS.index("parenchyma")}
    shown.hide(frozenset(PARTS))
    assert "field" not in plotter.meshes and not plotter.scalar_bars and shown.actor is None
    shown.hide(frozenset())
    shown.cut(None)
    shown.enlarge(1.0)
    assert drawn().bounds[2:4] == pytest.approx((-30.0, 30.0), rel=ROUNDING)
