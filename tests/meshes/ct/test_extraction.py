"""A bone out of a CT, held to a ball that is known exactly."""

from dataclasses import replace

import numpy as np
import pytest
from ct_ball import CENTRE_MM, DENSE_HU, RADIUS_MM, SHELL_MM, SPARSE_HU, ball, ball_mask

from meshes.base.errors import InputError
from meshes.ct.extraction import by_label, by_threshold, cropped
from meshes.ct.inspection import Histogram, histogram_of, inspect, suggest_threshold

VOLUME_MM3 = 4.0 / 3.0 * np.pi * RADIUS_MM**3
SPACINGS = [(0.5, 0.5, 0.5), (1.0, 1.0, 1.0), (0.8, 0.8, 1.5)]


def law(values):
    return (np.asarray(values, dtype=np.float32) + 500.0).astype(np.float32)


def away_mm(bone):
    return np.linalg.norm(bone.triangles[0] - CENTRE_MM, axis=1) - RADIUS_MM


@pytest.mark.parametrize("spacing_mm", SPACINGS)
def test_the_surface_of_a_threshold_is_that_of_the_ball(spacing_mm):
    image = ball(spacing_mm, noise_hu=20.0)
    bone = by_threshold(image, 0.5 * (DENSE_HU + 50.0))
    away = away_mm(bone)
    assert abs(away.mean()) < 0.05 * max(spacing_mm) and away.std() < 0.06 * max(spacing_mm)
    assert bone.volume_mm3 == pytest.approx(VOLUME_MM3, rel=0.01)
    assert not bone.cuts


@pytest.mark.parametrize("spacing_mm", SPACINGS)
def test_the_surface_of_a_label_keeps_its_volume_and_loses_its_steps(spacing_mm):
    image = ball(spacing_mm)
    mask = ball_mask(image)
    bone = by_label(image, mask)
    away = away_mm(bone)
    assert abs(away.mean()) < 0.06 * max(spacing_mm) and away.std() < 0.12 * max(spacing_mm)
    assert bone.volume_mm3 == pytest.approx(mask.sum() * np.prod(spacing_mm), rel=0.015)
    assert not bone.notes


def test_the_volume_of_left_out_pieces_of_a_label_is_noted():
    image = ball((1.0, 1.0, 1.0))
    mask = ball_mask(image)
    mask[0, 0, :2] = mask[-1, -1, -1] = True
    assert by_label(image, mask).notes == (
        "0.003 ml of the label lie in separate pieces and are left out.",
    )


@pytest.mark.parametrize("spacing_mm", SPACINGS)
@pytest.mark.parametrize("labelled", [False, True])
def test_density_holds_up_to_the_surface(spacing_mm, labelled):
    image = ball(spacing_mm, noise_hu=20.0)
    bone = by_label(image, ball_mask(image)) if labelled else by_threshold(image, 475.0)
    density = bone.density(law)
    axes = [
        o + s * np.arange(n)
        for o, s, n in zip(density.origin_mm, spacing_mm, density.values.shape, strict=True)
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    radius = np.linalg.norm(grid - CENTRE_MM, axis=-1)
    outer = (radius > RADIUS_MM - 1.0) & (radius < RADIUS_MM)
    inner = radius < RADIUS_MM - SHELL_MM - max(spacing_mm)
    assert density.values[outer].mean() == pytest.approx(
        law(DENSE_HU), rel=0.03 if labelled else 0.01
    )
    assert density.values[inner].mean() == pytest.approx(law(SPARSE_HU), rel=0.005)
    beyond = (radius > RADIUS_MM) & (radius < RADIUS_MM + max(spacing_mm))
    assert (density.values[beyond] > 0).mean() > 0.98
    # A blur that was not undone would lower the outermost voxels by a fifth.
    assert image.values[cropping(image, density)][outer].mean() + 500.0 < 0.97 * law(DENSE_HU)


def cropping(image, part):
    first = np.rint((np.array(part.origin_mm) - image.origin_mm) / image.spacing_mm).astype(int)
    return tuple(slice(a, a + n) for a, n in zip(first, part.values.shape, strict=True))


@pytest.mark.parametrize("spike_HU", [900, 1400, 2000])
def test_no_voxel_of_bone_is_without_density(spike_HU):
    """A spike of one voxel holds less than half bone, far from voxels that hold more."""
    image = ball()
    values = image.values.copy()
    middle = values.shape[0] // 2
    values[middle, middle, middle + 10 :] = spike_HU
    bone = by_threshold(replace(image, values=values), 250.0)
    density = bone.density(lambda grey: (grey + 1100.0).astype(np.float32))
    assert density.values[bone.field > bone.level].min() > 0


def test_marrow_is_part_of_the_bone_even_where_the_image_cuts_it():
    image = ball()
    image.values[ball_mask(image, radius_mm=RADIUS_MM - SHELL_MM)] = -80  # fat
    assert by_threshold(image, 475.0).volume_mm3 == pytest.approx(VOLUME_MM3, rel=0.02)
    half = cropped(image, ((0.3, -50.0, -50.0), (50.0, 50.0, 50.0)))
    bone = by_threshold(half, 475.0)
    assert bone.volume_mm3 == pytest.approx(0.5 * VOLUME_MM3, rel=0.05)
    assert len(bone.cuts) == 1 and "cut off" in " ".join(bone.notes)


def test_a_box_in_the_other_coordinate_system_is_recognised():
    image = replace(ball(), origin_mm=(100.0, 50.0, -20.0))
    for system, other in (("LPS", "RAS"), ("RAS", "LPS")):
        with pytest.raises(InputError, match=f"Give --coordinates {other} if the corners are in"):
            cropped(image, ((-110.0, -60.0, -15.0), (-104.0, -54.0, -5.0)), stated_in=system)
    with pytest.raises(InputError, match="Choose corners inside the image"):
        cropped(image, ((-110.0, 54.0, -15.0), (-104.0, 60.0, -5.0)))


def test_what_an_image_holds_is_found():
    found = inspect(ball(noise_hu=20.0))
    assert (
        found.is_hounsfield
        and found.noise == pytest.approx(20.0, rel=0.05)
        and found.metal_mm is None
    )
    assert found.low_mm == pytest.approx((-24.0,) * 3) and found.high_mm == pytest.approx(
        (24.0,) * 3
    )
    image = ball()
    image.values[20:24, 20:24, 20:24] = 3500
    metal = inspect(image)
    assert metal.metal_mm3 == 64.0 and metal.metal_mm == pytest.approx((-2.0, -2.0, -2.0), abs=1.1)
    other = ball()
    other.values[...] = 100 + other.values // 20
    assert not inspect(other).is_hounsfield


def test_a_threshold_is_suggested_between_soft_tissue_and_bone():
    image = ball(noise_hu=20.0)
    threshold, note = suggest_threshold(histogram_of(image.values), is_hounsfield=True)
    assert 150.0 <= threshold <= 600.0 and "above soft tissue at" in note
    assert by_threshold(image, threshold).volume_mm3 == pytest.approx(VOLUME_MM3, rel=0.05)


def test_a_threshold_lies_in_the_middle_of_the_gap_between_two_values():
    """A threshold lies in the middle of the gap between two values.

    Every value in the gap divides the image in one and the same manner, and the surface between
    voxels depends on the chosen one.
    """
    counts = np.zeros(1501, dtype=np.int64)
    counts[0], counts[1500] = 60_000, 40_000
    assert suggest_threshold(Histogram(0, counts), is_hounsfield=False)[0] == pytest.approx(
        750.0, abs=1
    )
