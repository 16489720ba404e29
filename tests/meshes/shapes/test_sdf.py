"""Laws of signed distances: Lipschitz bound, set algebra, unit slope, frames, dtypes, refusals."""

import numpy as np
import pytest

from meshes.shapes import sdf

SHAPES = {
    "sphere": sdf.sphere(4e-3, (1e-3, 0.0, -2e-3)),
    "box": sdf.box((8e-3, 6e-3, 4e-3)),
    "rounded box": sdf.box((8e-3, 6e-3, 4e-3), (1e-3, 0, 0), rounding_m=1e-3),
    "cylinder": sdf.cylinder(2e-3, (0, 0, -3e-3), (1e-3, 2e-3, 3e-3)),
    "capsule": sdf.capsule(1.5e-3, (0, 0, -3e-3), (1e-3, 2e-3, 3e-3)),
    "ellipsoid": sdf.ellipsoid((5e-3, 3e-3, 2e-3)),
    "half space": sdf.half_space((1, 2, 2), (1e-3, 0, 0)),
    "union": sdf.sphere(3e-3) | sdf.box((8e-3, 2e-3, 2e-3)),
    "intersection": sdf.sphere(3e-3) & sdf.box((8e-3, 4e-3, 2e-3)),
    "difference": sdf.box((6e-3, 6e-3, 6e-3)) - sdf.cylinder(1e-3, (0, 0, -1e-2), (0, 0, 1e-2)),
    "blended union": sdf.union(sdf.sphere(3e-3), sdf.box((8e-3, 2e-3, 2e-3)), blend_m=1e-3),
    "blended difference": sdf.difference(
        sdf.box((6e-3,) * 3), sdf.sphere(2e-3, (3e-3, 0, 0)), blend_m=1e-3
    ),
    "moved": sdf.box((8e-3, 6e-3, 4e-3)).translate((1e-3, -2e-3, 0)),
}
EXACT = ["sphere", "rounded box", "cylinder", "capsule", "half space"]
points_in_cube = pytest.mark.parametrize("seed", [0, 1, 2])


def points(seed: int, count: int = 4000) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-8e-3, 8e-3, (count, 3))


@pytest.mark.parametrize("name", SHAPES)
@points_in_cube
def test_distance_never_changes_faster_than_position(name, seed):
    a, b = points(seed), points(seed + 100)
    b[:2000] = a[:2000] + 1e-4 * (b[:2000] / 8e-3)
    change = np.abs(SHAPES[name].distance(a) - SHAPES[name].distance(b))
    assert (change <= np.linalg.norm(a - b, axis=1) * (1 + 1e-9) + 1e-15).all()


@pytest.mark.parametrize("name", EXACT)
def test_exact_distances_have_unit_slope_outside(name):
    shape, step = SHAPES[name], 1e-7
    p = points(3)
    p = p[shape.distance(p) > 1e-4]
    slope = np.stack(
        [(shape.distance(p + e) - shape.distance(p - e)) / (2 * step) for e in step * np.eye(3)],
        axis=1,
    )
    # second-order in step / distance 1e-4
    assert np.abs(np.linalg.norm(slope, axis=1) - 1.0).max() < 1e-3


@pytest.mark.parametrize("name", SHAPES)
def test_dtype_is_kept_and_float32_agrees(name):
    p = points(4)
    fine, coarse = SHAPES[name].distance(p), SHAPES[name].distance(p.astype(np.float32))
    assert fine.dtype == np.float64 and coarse.dtype == np.float32 and coarse.shape == (len(p),)
    assert np.abs(fine - coarse).max() < 1e-8  # 8 mm in single precision: 5e-10 m a rounding


def test_operators_are_set_algebra():
    a, b, p = SHAPES["sphere"], SHAPES["box"], points(6)
    in_a, in_b = a.distance(p) < 0, b.distance(p) < 0
    assert np.array_equal((a | b).distance(p) < 0, in_a | in_b)
    assert np.array_equal((a & b).distance(p) < 0, in_a & in_b)
    assert np.array_equal((a - b).distance(p) < 0, in_a & ~in_b)
    assert np.array_equal((a | b).distance(p), (b | a).distance(p))


def test_blend_adds_to_a_union_only_near_the_crease_and_at_most_a_quarter():
    a, b, p, blend = SHAPES["sphere"], SHAPES["box"], points(7), 1e-3
    gain = (a | b).distance(p) - sdf.union(a, b, blend_m=blend).distance(p)
    far = np.abs(a.distance(p) - b.distance(p)) >= blend
    assert (gain[far] == 0).all() and (gain >= 0).all() and gain.max() <= blend / 4 * (1 + 1e-12)
    assert gain[~far].max() > 0.2 * blend
