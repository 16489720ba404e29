"""Bad input about teeth: one sentence, exit code 2, through the command."""

import numpy as np
import pytest

from meshes import sdf
from meshes.anatomy import Anatomy
from meshes.voxelise import voxelise

FORCE_ONLY = ("--set", "voxels.spacing_mm=0.125", "--no-pictures", "--duration-s", "0.02")


def write_ball(path, radius_mm, centre_mm=(0.0, 0.0, 0.0)):
    """A closed ball as an STL file in mm."""
    import trimesh

    trimesh.creation.icosphere(subdivisions=3, radius=radius_mm).apply_translation(centre_mm).export(path)
    return str(path)


def test_a_bur_that_starts_inside_the_tooth_is_refused(refused, here):
    assert refused("run", "molar", *FORCE_ONLY, "--set", "motion.points_mm=[[0,0,-2],[0,0,-3]]") == (
        "motion must start outside the tooth, got a bur at (0, 0, -2) mm with 100% of its surface inside: start higher"
    )
    assert not (here / "runs").exists()


def test_a_placeholder_spacing_is_refused_with_the_size_it_makes(refused, here):
    import pyvista

    image = pyvista.ImageData(dimensions=(60, 60, 80), spacing=(1.0, 1.0, 1.0))
    labels = np.zeros((60, 60, 80), dtype=np.uint8)
    labels[10:50, 10:50, 10:50] = 3
    labels[10:50, 10:50, 50:70] = 2
    image.point_data["labels"] = labels.ravel(order="F")
    image.save(here / "labels.vti")
    said = refused("run", "molar", *FORCE_ONLY, "--set", "anatomy.file=labels.vti")
    assert said.startswith("anatomy.spacing_mm must make the tooth 5 to 40 mm long, got 1, which makes it ")


def test_unknown_labels_are_listed(refused, here):
    import pyvista

    image = pyvista.ImageData(dimensions=(40, 40, 60), spacing=(0.3, 0.3, 0.3))
    labels = np.full((40, 40, 60), 7, dtype=np.uint8)
    image.point_data["labels"] = labels.ravel(order="F")
    image.save(here / "labels.vti")
    said = refused("run", "molar", *FORCE_ONLY, "--set", "anatomy.file=labels.vti", "--set", "anatomy.spacing_mm=0.3")
    assert said.startswith("anatomy.file must name every label of labels.vti, got unnamed 7 (")


def test_layers_in_different_units_are_refused(refused, here):
    enamel = write_ball(here / "enamel.stl", 5.0, (0.0, 0.0, 6.0))
    dentin = write_ball(here / "dentin.stl", 6.0, (300.0, 0.0, 0.0))
    said = refused("run", "molar", *FORCE_ONLY, "--set", f"anatomy.enamel_file={enamel}",
                   "--set", f"anatomy.dentin_file={dentin}")  # fmt: skip
    assert "touch" in said or "tooth" in said


def test_a_layer_file_that_is_missing_is_named(refused, here):
    dentin = write_ball(here / "dentin.stl", 6.0)
    said = refused("run", "molar", *FORCE_ONLY, "--set", "anatomy.enamel_file=nowhere.stl",
                   "--set", f"anatomy.dentin_file={dentin}")  # fmt: skip
    assert "nowhere.stl" in said


def test_enamel_alone_is_no_tooth(refused, here):
    enamel = write_ball(here / "enamel.stl", 5.0)
    assert refused("run", "molar", *FORCE_ONLY, "--set", f"anatomy.enamel_file={enamel}") == (
        "anatomy.dentin_file must be given, got enamel: add the dentin"
    )


@pytest.mark.parametrize("part", ["stress={}", "heat=true"])
def test_what_only_a_tooth_has_is_refused_elsewhere(refused, here, part):
    said = refused("run", "milling", "--set", part)
    assert said in (
        "stress must be left out for a block, got a table: set anatomy.kind = molar, or remove it",
        "heat must be left out for a block, got true: set anatomy.kind = molar, or remove it",
    )


def test_a_tooth_that_nothing_supports_is_refused():
    """A ball of dentin with neither ligament nor bone, and no lower third to hold: only its springs would be left."""
    from meshes import InputError
    from tissue.tooth.field import _ligament_springs
    from tissue.tooth.grid import HexGrid

    ball = Anatomy(
        "ball",
        sdf.sphere(1e-3),
        ("dentin",),
        lambda points, depth: (np.zeros(len(points), np.uint8), np.full(len(points), 2100.0)),
    )
    volume = voxelise(ball, spacing_m=5e-4)
    solid = volume.fraction > 0
    grid = HexGrid.around(volume.origin_m + 5e-4 * (np.argwhere(solid) + 0.5), edge_m=1e-3)
    with pytest.raises(InputError, match="anatomy must hold a tooth that something supports, got none"):
        _ligament_springs(volume, np.ones_like(solid), grid, 2e-4)
