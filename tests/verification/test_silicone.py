"""Silicone cylinders pressed between platens: the modulus of one batch predicts the other batch.

Dawood et al. 2026: diameter 50 mm, height 30 mm, three mixes, batches A and B of five tests each.
Friction of the platens is unreported, so both limits are given: none, for which neo-Hookean has a
closed form, and bonded, which needs finite elements. One number is fitted, Young's modulus, on
batch A up to 30 % compression; the force of batch B is predicted. The force is proportional to the
modulus, so one solve serves all.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from newton_press import NewtonSolver
from numpy.typing import NDArray
from round_bodies import mapped
from scipy.optimize import nnls

from tissue.fem.hyperelastic import NonlinearBody
from tissue.fem.space import Space
from tissue.materials.hyperelasticity import Hyperelastic

RADIUS_M, HEIGHT_M = 0.025, 0.03


AREA_M2 = np.pi * RADIUS_M**2


MIXES = ("EF10_100T", "EF10_75T", "EF10_50T")


def traces(folder: Path, mix: str, batch: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """Compression and stress [Pa] of each test; the load of the first row is taken as zero."""
    found = []
    for path in sorted((folder / "traces" / mix).glob(f"{mix}_{batch}?.csv")):
        table = np.loadtxt(path, delimiter=",", skiprows=8)
        found.append((1e-3 * table[:, 1] / HEIGHT_M, (table[:, 2] - table[0, 2]) / AREA_M2))
    return found


Array = NDArray[np.float64]


EXPONENTS = np.concatenate([np.arange(-12.0, -0.9, 0.1), np.arange(1.0, 12.1, 0.1)])
"""Exponents of an Ogden law of one term that are tried."""


Column = Callable[[Array], list[Array]]
"""Curves of a law, each multiplied by a nonnegative constant.

There is one table of curves for each shape that is tried.
"""


def neo_hookean_column(compression: Array) -> list[Array]:
    """Times Young's modulus."""
    along = 1.0 - compression
    return [((along**-2 - along) / 3.0)[:, None]]


def yeoh_column(compression: Array) -> list[Array]:
    """Times c1, c2 and c3: derivatives of powers of I1 - 3 by the stretch."""
    along = 1.0 - compression
    slope, invariant = 2.0 * (along**-2 - along), along**2 + 2.0 / along - 3.0
    return [np.column_stack([k * invariant ** (k - 1) * slope for k in (1, 2, 3)])]


def ogden_column(compression: Array) -> list[Array]:
    """Times the shear modulus, for one exponent after the other."""
    along = 1.0 - compression
    return [
        (2.0 / a * (along ** (-0.5 * a - 1.0) - along ** (a - 1.0)))[:, None] for a in EXPONENTS
    ]


def fitted(column: Column, compression: Array, stress_Pa: Array) -> Array:
    """Stress of a law with the constants nearest to a measured curve [Pa], shape as the curve."""
    found = [(*nnls(curves, stress_Pa), curves) for curves in column(compression)]
    constants, _, curves = min(found, key=lambda each: each[1])
    return curves @ constants


POISSON = 0.49
"""Silicone hardly changes its volume; between bonded platens of this shape 0.499 adds 2 to 4 %."""
LAW = Hyperelastic.neo_hookean(0.5 / (1.0 + POISSON), bulk_Pa=1.0 / (3.0 * (1.0 - 2.0 * POISSON)))
SMALL = np.array([1e-5])
"""Compression at which the law is linear, to 1e-5."""
FITTED = 0.3
"""Compression up to which a modulus is fitted and held against the other batch."""


def octant(unit: np.ndarray) -> np.ndarray:
    """Unit cube to an eighth of the cylinder, finer towards the platen."""
    a, b, c = unit.T
    across = np.column_stack([a * np.sqrt(1.0 - b * b / 2.0), b * np.sqrt(1.0 - a * a / 2.0)])
    return np.column_stack([RADIUS_M * across, 0.5 * HEIGHT_M * (1.0 - (1.0 - c) ** 1.5)])


def pressed(compression: np.ndarray, *, bonded: bool, cells=(4, 4, 5)) -> np.ndarray:
    """Force over area and Young's modulus at each compression, from quadratic tetrahedra."""
    space = Space(mapped(cells, octant), 2)
    nodes = space.nodes_m
    held = np.abs(nodes) < 1e-9
    top = nodes[:, 2] > 0.5 * HEIGHT_M - 1e-9
    held[top] = held[top] | np.array([bonded, bonded, True])
    solver = NewtonSolver(NonlinearBody(space, law=LAW), held, tolerance=1e-6)
    moved, force = None, []
    for share in compression:
        goal = np.zeros_like(nodes)
        goal[top, 2] = -0.5 * HEIGHT_M * share
        solution = solver.solve(goal, start_m=moved)
        assert solution.converged, solution.outcome
        moved = solution.displacement_m
        force.append(-4.0 * solution.force_N[top, 2].sum() / AREA_M2)
    return np.array(force)


def frictionless(compression: np.ndarray) -> np.ndarray:
    """Incompressible neo-Hookean column: ``(lambda^-2 - lambda) / 3`` of the modulus."""
    return ((1.0 - compression) ** -2 - (1.0 - compression)) / 3.0


def test_column_without_friction():
    """A column without friction follows the closed form.

    Quadratic tetrahedra are compared with the same compressible law, with the lateral stretch by
    bisection.
    """
    share = np.array([0.1, 0.2, 0.3])
    exact = []
    for along in 1.0 - share:
        low, high = 1.0, 2.0
        for _ in range(60):
            across = 0.5 * (low + high)
            stress = LAW.stress(np.diag([across, across, along]))
            low, high = (low, across) if stress[0, 0] > 0.0 else (across, high)
        exact.append(-stress[2, 2])
    # The polygon of the coarse rim lacks area; a uniform stretch is otherwise exact.
    area = 4.0 * Space(mapped((4, 4, 5), octant)).volumes_m3.sum() / (0.5 * HEIGHT_M) / AREA_M2
    np.testing.assert_allclose(pressed(share, bonded=False), area * np.array(exact), rtol=1e-5)
    np.testing.assert_allclose(exact, frictionless(share), rtol=0.02)


@pytest.mark.slow
def test_batch_predicts_batch(anatomy, capsys):
    """One batch predicts the other to 30 % compression.

    Batch B is within 10 % (L2) of the prediction, for all mixes and both limits of friction.
    Batches scatter by 2 to 7 % against each other at one compression, so a single modulus cannot do
    better. Beyond 50 % the silicone stiffens more than neo-Hookean: the error there is printed and
    must show.
    """
    knots = np.linspace(0.0, FITTED, 11)
    bonded = np.concatenate([[0.0], pressed(knots[1:], bonded=True)])
    linear = float(pressed(SMALL, bonded=True)[0] / SMALL[0])
    limits = {
        "no friction, neo-Hookean": frictionless,
        "bonded, neo-Hookean": lambda share: np.interp(share, knots, bonded),
        "bonded, linear": lambda share: linear * share,
    }
    lines, errors, late = [], {name: [] for name in limits}, []
    for mix in MIXES:
        known, unknown = (
            [(s[s <= FITTED], p[s <= FITTED]) for s, p in traces(anatomy, mix, batch)]
            for batch in "AB"
        )
        assert len(known) == len(unknown) == 5
        for name, shape in limits.items():
            basis = np.concatenate([shape(s) for s, _ in known])
            young = float(basis @ np.concatenate([p for _, p in known]) / (basis @ basis))
            off = [np.linalg.norm(young * shape(s) - p) / np.linalg.norm(p) for s, p in unknown]
            errors[name] += off
            lines.append(
                f"{mix:10} {name:26} E {1e-3 * young:6.2f} kPa   batch B off by "
                f"{np.mean(off):6.1%}, at most {max(off):6.1%}"
            )
            if shape is frictionless:
                at = [np.interp(0.6, s, p) for s, p in traces(anatomy, mix, "B")]
                late.append(1.0 - young * frictionless(np.array(0.6)) / np.mean(at))
    with capsys.disabled():
        print("\n" + "\n".join(lines))
        print(
            "at 60 % compression the prediction without friction is short by "
            + ", ".join(f"{v:.0%}" for v in late)
        )
    assert max(errors["no friction, neo-Hookean"] + errors["bonded, neo-Hookean"]) < 0.10
    assert np.mean(errors["bonded, linear"]) > np.mean(errors["bonded, neo-Hookean"])
    assert min(late) > 0.2


@pytest.mark.parametrize(
    ("column", "most"), [(yeoh_column, 0.1), (ogden_column, 0.1), (neo_hookean_column, 0.25)]
)
def test_a_stiffening_law_predicts_the_other_batch_to_60_percent(anatomy, column, most):
    """A stiffening law predicts the other batch to 60 %.

    The constants come from batch A. The error of batch B is the root mean square over its tests,
    relative to its mean curve (L2). Batches are 3.6 to 8.5 % apart. Neo-Hookean, which does not
    stiffen enough, fails.
    """
    at, errors = np.linspace(0.01, 0.6, 60), []
    for mix in MIXES:
        known, unknown = (
            np.array([np.interp(at, s, p) for s, p in traces(anatomy, mix, batch)])
            for batch in "AB"
        )
        predicted = fitted(column, at, known.mean(axis=0))
        off = np.linalg.norm(unknown - predicted, axis=1) / np.linalg.norm(unknown.mean(axis=0))
        errors.append(float(np.sqrt(np.mean(off**2))))
    print(
        column.__name__,
        " ".join(f"{mix} {error:.1%}" for mix, error in zip(MIXES, errors, strict=True)),
    )
    assert max(errors) < most
    assert (max(errors) > 0.1) == (column is neo_hookean_column)


@pytest.mark.slow
@pytest.mark.parametrize("bonded", [False, True])
def test_small_strains_of_a_batch_predict_the_other_within_twice_the_scatter(
    anatomy, bonded, capsys
):
    """Small strains of a batch predict the other within twice the scatter.

    The linear law is used on the engine's mesh, to 5 % compression; the scatter is the standard
    deviation of all ten tests. To 30 % the law is off by more than twice the scatter, which the
    figure must show.
    """
    stiffness = float(pressed(SMALL, bonded=bonded)[0] / SMALL[0])
    errors = {
        most: [offness(anatomy, mix, stiffness, most) for mix in MIXES] for most in (0.05, 0.3)
    }
    with capsys.disabled():
        for most, found in errors.items():
            text = ", ".join(
                f"{1e-3 * young:.2f} kPa {share:.2f} scatters" for young, share in found
            )
            print(
                f"\nlinear to {most:.0%}, {'bonded' if bonded else 'no friction'}: {text}", end=""
            )
    assert max(share for _, share in errors[0.05]) < 2.0
    assert min(share for _, share in errors[0.3]) > 2.0


def offness(folder: Path, mix: str, stiffness: float, most: float) -> tuple[float, float]:
    """Return Young's modulus [Pa] by batch A, and its error for batch B over both scatters."""
    at = np.linspace(0.01, most, round(100 * most))
    known, unknown = (
        np.array([np.interp(at, s, p) for s, p in traces(folder, mix, batch)]) for batch in "AB"
    )
    both = np.concatenate([known, unknown])
    young = float((known @ at).sum() / (stiffness * len(known) * (at @ at)))
    error = np.sqrt(np.mean((unknown - young * stiffness * at) ** 2))
    scatter = np.sqrt(np.sum((both - both.mean(axis=0)) ** 2) / ((len(both) - 1) * len(at)))
    return young, float(error / scatter)
