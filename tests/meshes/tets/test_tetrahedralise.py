"""Surfaces filled with tetrahedra: a ball, the real liver, the cache, reports on bad surfaces."""

from pathlib import Path

import numpy as np
import pytest
import pyvista
from numpy.typing import NDArray

import meshes.tets.tetrahedralise as module
from meshes.surfaces.surface import Surface, read_surface, surface_from_triangles
from meshes.tets.files import read_tets
from meshes.tets.tetrahedra import mean_ratio
from meshes.tets.tetrahedralise import tetrahedralise


@pytest.fixture(autouse=True)
def private_cache(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The liver takes half a minute to fill: once for all slow tests, from the machine's own cache.
    if request.node.get_closest_marker("slow") is None:
        monkeypatch.setenv("TISSUE_CACHE", str(tmp_path / "cache"))


def ball(*, flipped: bool = False) -> Surface:
    """Ball of 50 mm radius."""
    sphere = pyvista.Icosphere(radius=50.0, nsub=2)
    faces = np.asarray(sphere.faces).reshape(-1, 4)[:, 1:]
    return surface_from_triangles(
        np.asarray(sphere.points), faces[:, ::-1] if flipped else faces, scale_mm=1.0
    )


def test_a_ball_is_filled_quietly_once_and_comes_from_the_cache_after(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[tuple[str, float]] = []
    surface = ball()
    mesh, message = tetrahedralise(
        surface, edge_m=0.02, report=lambda doing, share: calls.append((doing, share))
    )
    assert capfd.readouterr() == ("", "")
    assert calls[0][1] == 0.0
    assert calls[-1][1] == 1.0
    assert mesh.volumes_m3.sum() == pytest.approx(surface.report.volume_mm3 * 1e-9, rel=1e-6)
    # The envelope is 0.4 mm, and the mesh is then moved out by as much at most.
    radius = np.linalg.norm(mesh.nodes_m[mesh.surface_nodes], axis=1)
    assert radius.max() < 0.05 + 2.0 * 4e-4
    assert mean_ratio(mesh.nodes_m, mesh.cells).min() > 0.1
    assert "inverted" not in " ".join(message)

    def never(surface: Surface, edge: float) -> None:
        raise AssertionError("the mesh must come from the cache")

    monkeypatch.setattr(module, "_filled", never)
    again, _ = tetrahedralise(ball(), edge_m=0.02)
    assert np.array_equal(again.cells, mesh.cells)
    assert np.array_equal(again.nodes_m, mesh.nodes_m)


def _polydata(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> pyvista.PolyData:
    # what it does not use misleads the search
    return pyvista.PolyData.from_regular_faces(points, triangles).clean()


@pytest.mark.slow
def test_the_liver_surface_is_repaired_and_filled(anatomy: Path) -> None:
    found = read_tets(anatomy / "liver" / "liver.vtk", edge_m=0.02)
    message = " ".join(found.sentences)
    assert "taken to be in millimetres: 194 x 154 x 156 mm" in message
    assert "Dropped 3 loose pieces, the largest 0.059 mm long." in message
    assert "Turned the surface outward: it was wound inward." in message
    # 1477.2 ml as measured on the file.
    assert found.mesh.volumes_m3.sum() == pytest.approx(1.4772e-3, rel=1e-4)
    scanned = read_surface(anatomy / "liver" / "liver.vtk", scale_mm=1.0)
    given, made = (
        _polydata(scanned.vertices_m, scanned.faces),
        _polydata(found.mesh.nodes_m, found.mesh.surface),
    )
    for one, other in ((given, made), (made, given)):
        away = one.subdivide(2).compute_implicit_distance(other)["implicit_distance"]
        assert np.abs(away).max() < 0.5e-3
    assert mean_ratio(found.mesh.nodes_m, found.mesh.cells).min() > 0.05
