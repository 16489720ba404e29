"""Bad input about teeth: one sentence, exit code 2, through the command."""

import numpy as np
import pytest

from meshes.base.errors import InputError
from meshes.voxels.volume import VoxelVolume

FORCE_ONLY = ("--set", "voxels.spacing_mm=0.125", "--no-pictures", "--duration-s", "0.02")


def write_ball(path, radius_mm, centre_mm=(0.0, 0.0, 0.0)):
    """A closed ball as an STL file in mm."""
    import trimesh

    trimesh.creation.icosphere(subdivisions=3, radius=radius_mm).apply_translation(
        centre_mm
    ).export(path)
    return str(path)


def test_a_bur_that_starts_inside_the_tooth_is_refused(refused, here):
    assert refused(
        "run", "molar", *FORCE_ONLY, "--set", "motion.points_mm=[[0,0,-2],[0,0,-3]]"
    ) == (
        "motion must start outside the tooth, got a bur at (0, 0, -2) mm with 100% of its "
        "surface inside: start higher"
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
    message = refused("run", "molar", *FORCE_ONLY, "--set", "anatomy.file=labels.vti")
    assert message.startswith(
        "anatomy.spacing_mm must make the tooth 5 to 40 mm long, got 1, which makes it "
    )


def test_unknown_labels_are_listed(refused, here):
    import pyvista

    image = pyvista.ImageData(dimensions=(40, 40, 60), spacing=(0.3, 0.3, 0.3))
    labels = np.full((40, 40, 60), 7, dtype=np.uint8)
    image.point_data["labels"] = labels.ravel(order="F")
    image.save(here / "labels.vti")
    message = refused(
        "run",
        "molar",
        *FORCE_ONLY,
        "--set",
        "anatomy.file=labels.vti",
        "--set",
        "anatomy.spacing_mm=0.3",
    )
    assert message.startswith("anatomy.file must name every label of labels.vti, got unnamed 7 (")


def test_layers_in_different_units_are_refused(refused, here):
    enamel = write_ball(here / "enamel.stl", 5.0, (0.0, 0.0, 6.0))
    dentin = write_ball(here / "dentin.stl", 6.0, (300.0, 0.0, 0.0))
    message = refused(
        "run",
        "molar",
        *FORCE_ONLY,
        "--set",
        f"anatomy.enamel_file={enamel}",
        "--set",
        f"anatomy.dentin_file={dentin}",
    )
    assert "touch" in message or "tooth" in message


def test_a_layer_file_that_is_missing_is_named(refused, here):
    dentin = write_ball(here / "dentin.stl", 6.0)
    message = refused(
        "run",
        "molar",
        *FORCE_ONLY,
        "--set",
        "anatomy.enamel_file=nowhere.stl",
        "--set",
        f"anatomy.dentin_file={dentin}",
    )
    assert "nowhere.stl" in message


def test_enamel_alone_is_no_tooth(refused, here):
    enamel = write_ball(here / "enamel.stl", 5.0)
    message = refused("run", "molar", *FORCE_ONLY, "--set", f"anatomy.enamel_file={enamel}")
    assert "anatomy.dentin_file" in message and "add the dentin" in message


@pytest.mark.parametrize("part", ["stress={}", "heat=true"])
def test_what_only_a_tooth_has_is_refused_elsewhere(refused, here, part):
    message = refused("run", "milling", "--set", part)
    assert message in (
        "stress must be left out for a block, got a table: set anatomy.kind = molar, or remove it",
        "heat must be left out for a block, got true: set anatomy.kind = molar, or remove it",
    )


def blocks(*labels):
    """Return voxels of 0.5 mm with a block of 6 x 4 x 9 of dentin in air.

    Named layers are added as blocks.
    """
    layers, names = np.zeros((16, 14, 30), np.uint8), ("dentin", "bone")
    fraction = np.zeros(layers.shape, np.uint8)
    fraction[5:11, 5:9, 8:17] = 255
    for part, name in labels:
        fraction[part], layers[part] = 255, names.index(name)
    return VoxelVolume(
        (0.0, 0.0, 0.0), 5e-4, fraction, layers, np.full(layers.shape, 2100, np.uint16), names
    )


def springs(volume):
    """Springs of a volume's dentin [N/m], summed over the points at each height."""
    from tissue.models.tooth.field import _ligament_springs

    solid = (volume.fraction > 0) & (volume.layer == 0)
    found = _ligament_springs(volume, solid, 2e-4)
    heights = np.floor(found.position_m[:, 2] / 5e-4)
    return {
        height: found.stiffness_N_m[heights == height].sum(axis=0) for height in np.unique(heights)
    }


def test_a_tooth_whose_bone_does_not_touch_it_is_refused():
    with pytest.raises(
        InputError, match="anatomy must hold a tooth that something supports, got none"
    ):
        springs(blocks((np.s_[:, :, 26:], "bone")))


def test_a_tooth_without_a_bed_is_held_at_its_lower_third_whether_or_not_it_fills_its_volume():
    volume = blocks()
    arrays = (volume.fraction, volume.layer, volume.density_kg_m3)
    cut = [np.ascontiguousarray(array[5:11, 5:9, 8:17]) for array in arrays]
    filled = VoxelVolume((25e-4, 25e-4, 40e-4), 5e-4, *cut, ("dentin", "bone"))
    wanted, found = springs(volume), springs(filled)
    assert found.keys() == wanted.keys() and min(found) == 8
    for height, sums in wanted.items():
        np.testing.assert_allclose(found[height], sums, rtol=1e-6, atol=1e-6 * sums.max())
    assert sorted(wanted) == [8, 9]
