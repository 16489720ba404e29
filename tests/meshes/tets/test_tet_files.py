"""Tetrahedral meshes from files.

The tests cover the real livers, other formats, parts, units, and files that cannot be used.
"""

import sys
from pathlib import Path

import numpy as np
import pytest
import pyvista

from meshes.base.errors import InputError
from meshes.tets.files import read_tets
from meshes.tets.msh import read_msh
from meshes.tets.structured import box
from meshes.tets.tetrahedra import TetMesh

pytestmark = pytest.mark.usefixtures("parsed_here")
NODES = "$Nodes\n4\n1 0 0 0\n2 100 0 0\n3 0 100 0\n4 0 0 100\n$EndNodes\n"
FORM = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"


def grid_of(size_m: tuple[float, float, float] = (0.1, 0.1, 0.1)) -> pyvista.UnstructuredGrid:
    """Grid of a small box in mm."""
    mesh = box(size_m, (2, 2, 2))
    cells = np.column_stack([np.full(len(mesh.cells), 4), mesh.cells]).ravel()
    return pyvista.UnstructuredGrid(cells, np.full(len(mesh.cells), 10), 1e3 * mesh.nodes_m)


def test_the_coarse_liver_is_read_with_a_given_unit(anatomy: Path) -> None:
    # Counts, volume and box as measured on the file: 181 nodes, 596 tetrahedra, 36.5609 cubed
    # units, all positive.
    found = read_tets(anatomy / "liver" / "liver.v22.msh", unit_mm=34.3)
    assert (len(found.mesh.nodes_m), len(found.mesh.cells), len(found.mesh.surface)) == (
        181,
        596,
        276,
    )
    assert found.mesh.volumes_m3.sum() == pytest.approx(36.5609 * 0.0343**3, rel=1e-5)
    assert found.mesh.volumes_m3.min() == pytest.approx(0.00321 * 0.0343**3, rel=0.01)
    assert "34.3 mm per unit, as given: 222 x 169 x 152 mm" in found.sentences[0]
    assert not any("inverted" in sentence or "sliver" in sentence for sentence in found.sentences)


def test_the_finer_liver_keeps_its_tetrahedra_only_and_reports_the_smallest(anatomy: Path) -> None:
    found = read_tets(anatomy / "liver" / "liver2.v22.msh", unit_mm=100.0)
    assert (len(found.mesh.nodes_m), len(found.mesh.cells), len(found.mesh.surface)) == (
        507,
        1493,
        860,
    )
    assert found.mesh.volumes_m3.sum() == pytest.approx(1.12509e-3, rel=1e-5)
    # 71 lines and 860 triangles; smallest over largest volume 3.55e-6 / 6.28e-3. Its cells are
    # small, not flat.
    assert "Left out 931 elements that are not tetrahedra." in found.sentences
    smallest = found.mesh.cells[int(found.mesh.volumes_m3.argmin())]
    at = ", ".join(f"{x:.3g}" for x in 1e3 * found.mesh.nodes_m[smallest].mean(axis=0))
    assert any(
        f"at ({at}) mm, has 1/1769 of the volume" in sentence for sentence in found.sentences
    )
    assert any("lowest mean ratio 0.34" in sentence for sentence in found.sentences)


@pytest.mark.parametrize(("suffix", "factor"), [(".vtu", 1.0), (".vtk", 1.0), (".vtu", 1e-3)])
def test_vtk_files_are_read_in_millimetres_or_metres(
    tmp_path: Path, suffix: str, factor: float
) -> None:
    grid = grid_of()
    grid.points *= factor
    grid.save(tmp_path / f"organ{suffix}")
    found = read_tets(tmp_path / f"organ{suffix}")
    assert found.unit_mm == 1.0 / factor
    # Points may be stored in single precision.
    assert found.mesh.volumes_m3.sum() == pytest.approx(1e-3, rel=1e-6)


def test_an_array_of_integers_over_the_cells_gives_the_parts(tmp_path: Path) -> None:
    grid = grid_of()
    grid.cell_data["region"] = np.where(np.asarray(grid.cell_centers().points)[:, 2] > 50.0, 7, 3)
    grid.save(tmp_path / "organ.vtu")
    mesh = read_tets(tmp_path / "organ.vtu").mesh
    assert mesh.part_names == ("part 3", "part 7")
    assert mesh.volumes_m3[mesh.part == 1].sum() == pytest.approx(0.5e-3, rel=1e-6)
    assert (mesh.nodes_m[mesh.cells[mesh.part == 1]].mean(axis=1)[:, 2] > 0.05).all()


def test_physical_groups_of_gmsh_give_the_parts_and_their_names(tmp_path: Path) -> None:
    names = '$PhysicalNames\n2\n3 5 "liver tissue"\n2 6 "capsule"\n$EndPhysicalNames\n'
    nodes = NODES.replace("$Nodes\n4", "$Nodes\n5").replace("$EndNodes", "9 100 100 100\n$EndNodes")
    cells = "$Elements\n3\n1 4 2 5 0 1 2 3 4\n2 4 2 8 0 2 3 4 9\n3 15 2 0 0 1\n$EndElements\n"
    file = tmp_path / "organ.msh"
    file.write_text(FORM + names + nodes + cells)
    found = read_tets(file)
    assert found.mesh.part_names == ("liver tissue", "part 8")
    assert "Left out 1 elements that are not tetrahedra." in found.sentences
    assert read_msh(file).names == {5: "liver tissue"}


GMSH_4 = """$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
2
2 6 "capsule"
3 5 "liver tissue"
$EndPhysicalNames
$Entities
0 0 1 2
1 0 0 0 100 100 0 1 6 0
1 0 0 0 100 100 100 1 5 0
2 0 0 0 100 100 100 1 8 0
$EndEntities
$Nodes
1 5 10 50
3 1 0 5
10
20
30
40
50
0 0 0
100 0 0
0 100 0
0 0 100
100 100 100
$EndNodes
$Elements
3 3 1 3
2 1 2 1
1 10 20 30
3 1 4 1
2 10 20 30 40
3 2 4 1
3 20 30 40 50
$EndElements
"""
"""Two tetrahedra in two groups and a triangle."""


def test_a_gmsh_file_of_version_4_has_the_same_parts(tmp_path: Path, capfd) -> None:
    pytest.importorskip("meshio")
    file = tmp_path / "organ.msh"
    file.write_text(GMSH_4)
    found = read_tets(file)
    assert found.mesh.volumes_m3.sum() == pytest.approx(0.5e-3, rel=1e-12)
    assert found.mesh.part_names == ("liver tissue", "part 8")
    assert "Left out 1 elements that are not tetrahedra." in found.sentences
    file.write_text(GMSH_4.replace("liver tissue", 61 * "x"))
    with pytest.raises(InputError, match="have different names of 1 to 60 characters"):
        read_tets(file)
    file.write_text(GMSH_4[:-60])
    with pytest.raises(InputError, match="complete sections"):
        read_tets(file)
    assert capfd.readouterr() == ("", "")


def test_without_meshio_the_packages_to_install_are_named(tmp_path: Path, monkeypatch) -> None:
    file = tmp_path / "organ.msh"
    file.write_text(GMSH_4)
    monkeypatch.setitem(sys.modules, "meshio.gmsh", None)
    with pytest.raises(InputError, match='Run pip install "meshio>='):
        read_tets(file)


@pytest.mark.parametrize("version", ["2.2", "4.1"])
def test_binary_gmsh_files_are_read(tmp_path: Path, version: str) -> None:
    meshio = pytest.importorskip("meshio")
    grid = grid_of()
    cells = [("tetra", grid.cells_dict[10])]
    meshio.gmsh.write(
        tmp_path / "organ.msh", meshio.Mesh(grid.points, cells), fmt_version=version, binary=True
    )
    found = read_tets(tmp_path / "organ.msh")
    assert found.mesh.volumes_m3.sum() == pytest.approx(1e-3, rel=1e-9)


def test_a_gmsh_file_of_implausible_size_asks_for_its_unit(tmp_path: Path) -> None:
    file = tmp_path / "organ.msh"
    file.write_text(
        FORM + NODES.replace("100", "7") + "$Elements\n1\n1 4 0 1 2 3 4\n$EndElements\n"
    )
    with pytest.raises(InputError, match="because its size of 7 x 7 x 7 fits an organ neither"):
        read_tets(file)


def test_a_node_that_no_cell_uses_must_be_finite():
    mesh = box((0.1, 0.1, 0.1), (1, 1, 1))
    nodes_m = np.vstack([mesh.nodes_m, [0.0, np.nan, 0.0]])
    with pytest.raises(InputError, match=r"node 8 at \[ 0. nan  0.\]") as error:
        TetMesh(nodes_m, mesh.cells)
    assert "repair this node or leave it out" in str(error.value).lower()
