"""Nonlinear region of a linear body, against the whole body's stiffness and energy."""

import numpy as np
import pytest
from scipy.sparse import bsr_array

from meshes.tets.structured import box
from tissue.fem.assembly import assemble, capsule_stiffness
from tissue.fem.hyperelastic import NonlinearBody
from tissue.fem.region import RegionBody
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody, held_nodes
from tissue.fem.space import Space
from tissue.materials.elasticity import lame
from tissue.materials.hyperelasticity import Hyperelastic

LAME = lame(5e3, 0.4)
LAW = Hyperelastic.neo_hookean(LAME[1], bulk_Pa=LAME[0] + 2.0 / 3.0 * LAME[1])


def capsule(space: Space, faces: np.ndarray) -> bsr_array:
    """A capsule that is as stiff as a layer of 10 mm of the block."""
    return capsule_stiffness(space, thickness_m=5e-5, young_Pa=1e6, poisson_ratio=0.4, faces=faces)


def held_block(order: int, *, capsule_too: bool = False) -> tuple[Space, HeldBody]:
    """A block that stands on its base."""
    space = Space(box((0.04, 0.04, 0.03), (4, 4, 3)), order)
    fixed = held_nodes(space.nodes_m[:, 2] < 1e-9)
    stiffness = assemble(space, LAME)
    if capsule_too:
        stiffness = bsr_array(stiffness + capsule(space, space.faces))
    return space, HeldBody(stiffness, space.nodes_m, fixed)


def near_press(space: Space) -> tuple[np.ndarray, np.ndarray]:
    """Nodes near a press on the top: those of the top, and all."""
    near = np.linalg.norm(space.nodes_m - [0.01, 0.02, 0.03], axis=1) < 0.011
    return np.flatnonzero(near & (space.nodes_m[:, 2] > 0.029)), np.flatnonzero(near)


def region_of(
    space: Space, held: HeldBody, low_m: float, *, capsule_too: bool = False
) -> RegionBody:
    centres = space.nodes_m[space.cell_nodes].mean(axis=1)
    cells = np.flatnonzero((centres[:, 2] > low_m) & (centres[:, 0] < 0.03))
    return RegionBody(
        space,
        DirectSolver(held),
        cells,
        loaded=near_press(space),
        law=LAW,
        cell_factors=np.ones(space.cell_count),
        membrane=capsule if capsule_too else None,
    )


def solver_of(region: RegionBody) -> DirectSolver:
    """Solver of a region at rest."""
    rest = region.stiffness(np.zeros_like(region.nodes_m))
    return DirectSolver(HeldBody(rest, region.nodes_m, region.fixed, is_grounded=True))


@pytest.fixture
def every_mode(monkeypatch):
    """Let every displacement of a border be a mode."""
    monkeypatch.setattr("tissue.fem.region.MODES", 3000)
    monkeypatch.setattr("tissue.fem.region.LOADS", 1500)
    monkeypatch.setattr("tissue.fem.region.SMALLEST", 1e-13)
    monkeypatch.setitem(globals(), "near_press", lambda space: (np.arange(space.node_count),))


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(("low_m", "capsule_too"), [(0.01, False), (0.0, False), (0.01, True)])
def test_at_rest_the_region_has_the_compliance_of_the_body(order, low_m, capsule_too, every_mode):
    """With every mode, the compliance of the region's nodes at rest is that of the whole body.

    One region reaches the held base. A capsule counts once, inside and outside the region.
    """
    space, held = held_block(order, capsule_too=capsule_too)
    region = region_of(space, held, low_m, capsule_too=capsule_too)
    alone = solver_of(region)
    chosen = np.flatnonzero(~region.fixed[: len(region.nodes), 0])[::7]
    whole = DirectSolver(held).compliance_between(region.nodes[chosen])
    assert alone.compliance_between(chosen) == pytest.approx(whole, abs=1e-9 * np.abs(whole).max())


def test_the_shipped_number_of_modes_holds_the_compliance_under_a_tool():
    """With the modes that are shipped, a press in the middle moves the surface as in the body."""
    space, held = held_block(2)
    region = region_of(space, held, 0.01)
    alone = solver_of(region)
    top = region.nodes_m[: len(region.nodes)] - [0.01, 0.02, 0.03]
    pressed = np.flatnonzero(np.linalg.norm(top, axis=1) < 6e-3)
    whole = DirectSolver(held).compliance_between(region.nodes[pressed])
    found = alone.compliance_between(pressed)
    assert 0.0 < np.abs(found - whole).max() < 2e-3 * np.abs(whole).max()


@pytest.mark.parametrize("capsule_too", [False, True])
def test_energy_force_and_stiffness_belong_together(capsule_too):
    space, held = held_block(2, capsule_too=capsule_too)
    region = region_of(space, held, 0.01, capsule_too=capsule_too)
    random = np.random.default_rng(4)
    at = np.where(region.fixed, 0.0, 3e-4 * random.uniform(-1.0, 1.0, region.fixed.shape))
    direction = np.where(region.fixed, 0.0, random.normal(size=at.shape))
    h = 1e-8
    plus, minus = (region.energy_and_force(at + sign * h * direction) for sign in (1.0, -1.0))
    force = region.energy_and_force(at)[1]
    assert (plus[0] - minus[0]) / (2.0 * h) == pytest.approx(np.sum(force * direction), rel=1e-5)
    product = region.stiffness(at) @ direction.ravel()
    np.testing.assert_allclose(
        (plus[1] - minus[1]).ravel() / (2.0 * h), product, atol=1e-5 * np.abs(product).max()
    )


def test_a_region_of_all_cells_is_the_whole_body():
    space, held = held_block(1, capsule_too=True)
    cells = np.arange(space.cell_count)
    region = RegionBody(
        space,
        DirectSolver(held),
        cells,
        loaded=(np.arange(space.node_count),),
        law=LAW,
        cell_factors=np.ones(len(cells)),
        membrane=capsule,
    )
    whole = NonlinearBody(space, law=LAW, membrane=capsule(space, space.faces))
    moved = 1e-4 * np.random.default_rng(2).normal(size=space.nodes_m.shape)
    energy, force = region.energy_and_force(moved[region.nodes])
    exact, exact_N = whole.energy_and_force(moved)
    assert energy == pytest.approx(exact, rel=1e-12)
    assert force == pytest.approx(exact_N[region.nodes], abs=1e-12 * np.abs(exact_N).max())


def test_a_region_of_all_cells_but_one_corner_is_nearly_the_whole_body():
    """A linear corner that hardly moves leaves the energy of the whole body."""
    space, held = held_block(1, capsule_too=True)
    whole = NonlinearBody(space, law=LAW, membrane=capsule(space, space.faces))
    centres = space.nodes_m[space.cell_nodes].mean(axis=1)
    cells = np.flatnonzero(np.linalg.norm(centres, axis=1) > 0.01)
    region = RegionBody(
        space,
        DirectSolver(held),
        cells,
        loaded=(np.arange(space.node_count),),
        law=LAW,
        cell_factors=np.ones(space.cell_count),
        membrane=capsule,
    )
    moved = np.zeros_like(space.nodes_m)
    moved[:, 0] = 5e-3 * (space.nodes_m[:, 2] / 0.03) ** 2
    exact = whole.energy_and_force(moved)[0]
    assert region.energy_and_force(region.gathered(moved))[0] == pytest.approx(exact, rel=1e-2)
