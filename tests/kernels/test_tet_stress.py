"""Group means of strain and stress against NumPy, cell by cell."""

import numpy as np
import pytest
import warp as wp

from kernels.tet_stress import group_stress

ROUNDING = 1e-12
"""Of the largest value: sums of at most a few hundred products in float64."""
CELLS, PLACES, NODES, GROUPS = 12, 3, 20, 9
PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


def put(values, dtype):
    return wp.array(np.ascontiguousarray(values), dtype=dtype, device="cpu")


@pytest.mark.parametrize(("functions", "laws"), [(4, 1), (10, CELLS)], ids=["linear", "quadratic"])
def test_groups_against_numpy(functions, laws):
    """grad u = sum u_A (sum (slope_Ac . l) g_c)^T; von Mises from the deviator, principal values
    by eigvalsh.
    """
    random = np.random.default_rng(functions)
    at = random.dirichlet(np.ones(4), PLACES)
    slope = random.normal(size=(functions, 4, 4))
    nodes = random.integers(0, NODES, (CELLS, functions))
    gradient, volume = random.normal(size=(CELLS, 4, 3)), random.uniform(0.5, 2.0, CELLS)
    law = random.normal(size=(laws, 6, 6))
    law = law + law.transpose(0, 2, 1)
    moved = random.normal(size=(NODES, 3))
    sizes = random.integers(1, 6, GROUPS)
    sizes[3] = 0
    start = np.concatenate([[0], np.cumsum(sizes)])
    member = random.integers(0, CELLS * PLACES, start[-1])
    shapes = [
        ((GROUPS, 6), wp.float64),
        ((GROUPS, 6), wp.float64),
        (GROUPS, wp.float64),
        (GROUPS, wp.vec3d),
    ]
    out = [wp.zeros(shape, dtype=dtype, device="cpu") for shape, dtype in shapes]
    inputs = [
        put(start, wp.int32),
        put(member, wp.int32),
        put(at, wp.vec4d),
        put(slope, wp.vec4d),
        put(nodes, wp.int32),
        put(gradient, wp.vec3d),
        put(volume, wp.float64),
        put(law, wp.float64),
        put(moved, wp.vec3d),
        0,
    ]
    wp.launch(group_stress, dim=GROUPS, inputs=inputs, outputs=out, device="cpu")
    along = np.einsum("acl,pl,ncx->npax", slope, at, gradient)
    grad = np.einsum("nax,npay->npxy", moved[nodes], along)
    strain = 0.5 * (grad + grad.transpose(0, 1, 3, 2))
    voigt = np.stack([strain[..., i, j] for i, j in PAIRS], axis=-1)
    stress = np.einsum(
        "nij,npj->npi", np.broadcast_to(law, (CELLS, 6, 6)), voigt * [1, 1, 1, 2, 2, 2]
    )
    for group in range(GROUPS):
        cell, place = np.divmod(member[start[group] : start[group + 1]], PLACES)
        weight = volume[cell] / volume[cell].sum() if len(cell) else np.zeros(0)
        mean = weight @ stress[cell, place]
        scale = ROUNDING * max(np.abs(mean).max(), 1.0)
        assert out[0].numpy()[group] == pytest.approx(weight @ voigt[cell, place], abs=scale)
        assert out[1].numpy()[group] == pytest.approx(mean, abs=scale)
        tensor = np.empty((3, 3))
        for value, (i, j) in zip(mean, PAIRS, strict=True):
            tensor[i, j] = tensor[j, i] = value
        deviator = tensor - np.trace(tensor) / 3.0 * np.eye(3)
        assert out[2].numpy()[group] == pytest.approx(np.sqrt(1.5 * (deviator**2).sum()), abs=scale)
        # acos loses half the digits where two principal values nearly meet
        assert out[3].numpy()[group] == pytest.approx(
            np.linalg.eigvalsh(tensor)[::-1], abs=1e4 * scale
        )
