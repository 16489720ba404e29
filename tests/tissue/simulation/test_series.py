"""Fields over time, written and read back."""

import numpy as np
import pytest
from fake_fields import block_series

from tissue.fem.fields import FieldSeries, Frame
from tissue.simulation.vtk_files import frame_mesh, write_fields

pyvista = pytest.importorskip("pyvista")


def test_series_reads_back_with_times_and_arrays(tmp_path):
    series = block_series((0.0, 0.0, 0.0), (4e-3, 2e-3, 2e-3), (4, 2, 2), ("enamel", "dentin"))
    write_fields(series, tmp_path)
    reader = pyvista.PVDReader(tmp_path / "fields.pvd")
    assert reader.time_values == [0.0, 0.1, 0.25]
    for index, frame in enumerate(series.frames):
        reader.set_active_time_point(index)
        (mesh,) = reader.read()
        there = np.isfinite(frame.cells["von_mises_MPa"])
        assert there.sum() == 16 - index
        assert mesh.n_cells == there.sum()
        assert set(mesh.celltypes) == {pyvista.CellType.HEXAHEDRON}
        np.testing.assert_array_equal(
            mesh.cell_data["von_mises_MPa"], frame.cells["von_mises_MPa"][there]
        )
        np.testing.assert_array_equal(mesh.cell_data["layer"], series.layer[there])
        # Coordinates and displacements belong together, in single precision: u = t x, in um for x
        # in mm.
        np.testing.assert_allclose(
            mesh.point_data["displacement_um"], frame.time_s * mesh.points, rtol=1e-6, atol=1e-9
        )
        assert [str(name) for name in mesh.field_data["layer_names"]] == ["enamel", "dentin"]
        # Each cell is a cube of 1 mm3 in the right order: a wrong order of its nodes would give
        # another volume.
        volumes = mesh.compute_cell_sizes(length=False, area=False)["Volume"]
        np.testing.assert_allclose(volumes, 1.0, rtol=1e-5)
    assert sorted(path.name for path in (tmp_path / "fields").iterdir()) == [
        f"frame_000{i}.vtu" for i in range(3)
    ]


def test_tetrahedra_and_vectors_of_cells():
    nodes = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]) * 1e-3
    series = FieldSeries(
        nodes, np.array([[0, 1, 2, 3], [1, 2, 3, 4]]), np.zeros(2, np.uint8), ("liver",)
    )
    direction = np.array([[1, 0, 0], [np.nan] * 3], dtype=np.float32)
    mesh = frame_mesh(series, Frame(0.0, {}, {"direction": direction}))
    assert list(mesh.celltypes) == [pyvista.CellType.TETRA]
    np.testing.assert_array_equal(mesh.cell_data["direction"], direction[:1])
    np.testing.assert_allclose(mesh.volume, 1.0 / 6.0, rtol=1e-6)
