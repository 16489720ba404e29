"""Voxelised shapes.

The tests cover order of convergence, agreement with brute force, independence of the region, and
refusals.
"""

import math

import numpy as np
import pytest

from meshes.base.errors import InputError
from meshes.shapes import sdf
from meshes.shapes.anatomy import Anatomy, cortical_block
from meshes.surfaces.glenoid import glenoid
from meshes.voxels.voxelise import voxel_fraction, voxelise

# stored fractions are integers of 255: evaluations in another order may round differently
ROUNDING = 1


def uniform(shape: sdf.Shape) -> Anatomy:
    return Anatomy("test", shape, ("cortical",), cortical_block().classify)


def brute_force(anatomy, volume):
    """Every voxel on its own, float64."""
    axes = [volume.centres_m(axis) for axis in range(3)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    distance = anatomy.shape.distance(centres)
    fraction = voxel_fraction(anatomy.shape, centres, distance, volume.spacing_m)
    layer, density = anatomy.classify(centres, -distance)
    return (a.reshape(volume.shape) for a in (fraction, layer, density, distance))


def test_sphere_volume_converges_at_second_order():
    radius, spacings = 5e-3, np.array([8e-4, 4e-4, 2e-4, 1e-4])
    exact = 4 / 3 * math.pi * radius**3
    errors = []
    for spacing in spacings:
        off_lattice = [(0.13 * k * spacing, 0.37 * spacing, 0.29 * k * spacing) for k in range(3)]
        volumes = [
            voxelise(uniform(sdf.sphere(radius, c)), spacing_m=spacing).volume_m3()
            for c in off_lattice
        ]
        errors.append(abs(np.mean(volumes) / exact - 1))
    slope = np.polyfit(np.log(spacings), np.log(errors), 1)[0]
    assert slope > 1.8
    assert errors[-1] < 1.5e-4  # (h/R)^2/4, the sagitta within a voxel


@pytest.mark.parametrize(
    "anatomy",
    [
        uniform(sdf.sphere(3e-3, (1.3e-4, 0, -3e-3))),
        uniform(sdf.box((4e-3, 3e-3, 5e-3)) - sdf.cylinder(8e-4, (0, 0, -5e-3), (0, 0, 5e-3))),
        uniform(sdf.ellipsoid((4e-3, 2e-3, 1.5e-3))),
    ],
    ids=["sphere", "drilled box", "ellipsoid"],
)
def test_coarse_to_fine_is_brute_force(anatomy):
    volume = voxelise(anatomy, spacing_m=1e-4)
    fraction, _, _, _ = brute_force(anatomy, volume)
    assert np.abs(volume.fraction - fraction * 255.0).max() <= ROUNDING


def test_a_voxel_does_not_depend_on_the_region():
    anatomy, spacing = glenoid(), 1e-4
    whole = voxelise(
        anatomy, spacing_m=spacing, region_m=((-5e-3, -4e-3, -4e-3), (5e-3, 4e-3, 1e-3))
    )
    part = voxelise(
        anatomy, spacing_m=spacing, region_m=((-3.1e-3, -0.57e-3, -2.33e-3), (1.2e-3, 3e-3, 0.5e-3))
    )
    first = np.rint((part.origin_m - whole.origin_m) / spacing).astype(int)
    window = tuple(slice(a, a + n) for a, n in zip(first, part.shape, strict=True))
    for name in ("fraction", "layer", "density_kg_m3"):
        assert np.array_equal(getattr(part, name), getattr(whole, name)[window]), name
    assert np.allclose(part.origin_m / spacing, np.rint(part.origin_m / spacing), atol=1e-9)


def test_block_on_the_lattice_is_exact():
    volume = voxelise(cortical_block(size_mm=(20, 12, 8)), spacing_m=1e-4)
    assert volume.shape == (204, 124, 84)  # two voxels of air around it
    bone = (slice(2, -2),) * 3
    assert (volume.fraction[bone] == 255).all() and np.count_nonzero(
        volume.fraction
    ) == 200 * 120 * 80
    assert volume.volume_m3() == pytest.approx(20 * 12 * 8 * 1e-9, rel=1e-12)
    assert volume.bounds_m[1][2] == pytest.approx(2e-4, abs=1e-15)
    assert (volume.density_kg_m3[bone] == 1800).all() and volume.layer_names == ("cortical",)


def test_pilot_hole_is_subtracted_within_voxels():
    solid = cortical_block(size_mm=(8, 8, 6))
    spacing = 1e-4
    hole = sdf.cylinder(2.03e-3, (0.04e-3, 0, -4.02e-3), (0.04e-3, 0, 1e-3))
    drilled = voxelise(solid, spacing_m=spacing, minus=hole)
    whole = voxelise(solid, spacing_m=spacing)
    taken = whole.volume_m3() - drilled.volume_m3()
    assert taken == pytest.approx(math.pi * 2.03e-3**2 * 4.02e-3, rel=1e-3)
    empty = drilled.fraction[drilled.shape[0] // 2, drilled.shape[1] // 2, -32:]
    assert (empty == 0).all()
    apart = voxelise(solid, spacing_m=spacing, minus=sdf.sphere(1e-3, (1.0, 0, 0)))
    assert (apart.fraction == whole.fraction).all()


def test_endless_shape_needs_a_region():
    with pytest.raises(InputError, match="region_m"):
        voxelise(uniform(sdf.half_space((0, 0, 1))), spacing_m=1e-3)
    volume = voxelise(
        uniform(sdf.half_space((0, 0, 1))),
        spacing_m=1e-3,
        region_m=((0, 0, -2e-3), (1e-3, 1e-3, 2e-3)),
    )
    assert volume.volume_m3() == pytest.approx(2e-9)
