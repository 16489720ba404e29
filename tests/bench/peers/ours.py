"""Our side of every work: ``python ours.py PEER`` does what that peer is compared in."""

import sys
from math import prod
from pathlib import Path
from time import process_time

import numpy as np
from works import (
    BALL_M,
    BLOCK_M,
    BURR_M,
    CLAMPED_CELLS,
    CUBE_CELLS,
    DELAYS,
    FEED_M_S,
    HORIZON,
    POISSON,
    SLAB_M,
    SLABS,
    SPACING_M,
    STEP_S,
    YOUNG_PA,
    ball_tip,
    bricks_in_tetrahedra,
    burr_tip,
    contacts,
    print_result,
    timed,
)

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))
PACKAGES = "tissue-sim warp-lang numpy scipy"


def stiffness() -> None:
    """Measure the work of scikit-fem."""
    from meshes.tets.tetrahedra import TetMesh
    from tissue.fem.assembly import assemble
    from tissue.fem.solvers.direct import DirectSolver
    from tissue.fem.solvers.held_body import HeldBody, held_nodes
    from tissue.fem.space import Space
    from tissue.materials.elasticity import lame

    material, made = lame(YOUNG_PA, POISSON), {}

    def space_of(cells: tuple[int, ...]) -> Space:
        return Space(TetMesh(*bricks_in_tetrahedra((1.0, 1.0, 1.0), cells)), 1)

    space = space_of(CUBE_CELLS)
    size = f"{space.cell_count} tetrahedra"
    times = timed(lambda _: made.update(K=assemble(space, material)), count=15, warm_up=2)
    trace = made["K"].diagonal().sum()
    print_result("tissue", "stiffness again", size, times, PACKAGES, value=trace, unit="N/m, trace")
    times = timed(lambda _: made.update(K=assemble(space_of(CUBE_CELLS), material)), count=5)
    print_result(
        "tissue", "stiffness of a mesh", size, times, PACKAGES, value=trace, unit="N/m, trace"
    )

    space = space_of(CLAMPED_CELLS)
    held, top = space.nodes_m[:, 2] < 1e-9, space.nodes_m[:, 2] > 1.0 - 1e-9
    matrix, load = assemble(space, material), np.zeros(space.nodes_m.shape)
    load[top, 2] = -1.0 / top.sum()

    def solve(_: int) -> None:
        made["u"] = (
            DirectSolver(HeldBody(matrix, space.nodes_m, held_nodes(held)))
            .solve(load)
            .displacement_m
        )

    times = timed(solve, count=3)
    print_result(
        "tissue",
        "factorise and solve",
        f"{3 * len(held)} unknowns",
        times,
        PACKAGES,
        value=1e3 * made["u"][top, 2].mean(),
        unit="mm, mean of the top",
    )


def soft() -> None:
    """Measure the work of MuJoCo.

    It is contact with friction, quasi-static, on the compliance of the slab's top.
    """
    from meshes.tets.tetrahedra import TetMesh
    from tissue.fem.assembly import assemble
    from tissue.fem.solvers.condensed import surface_compliance_m_N
    from tissue.fem.solvers.held_body import HeldBody, held_nodes
    from tissue.fem.space import Space
    from tissue.materials.elasticity import lame
    from tissue.models.organ.contact import SurfaceContact
    from tissue.models.organ.probe import SphereProbe

    for cells in SLABS:
        mesh = TetMesh(*bricks_in_tetrahedra(SLAB_M, cells))
        space = Space(mesh, 1)
        body = HeldBody(
            assemble(space, lame(YOUNG_PA, POISSON)),
            space.nodes_m,
            held_nodes(space.nodes_m[:, 2] < 1e-9),
        )
        touchable = np.flatnonzero(space.nodes_m[:, 2] > SLAB_M[2] - 1e-9)
        compliance = surface_compliance_m_N(body, touchable)
        number = np.full(len(space.nodes_m), -1)
        number[touchable] = np.arange(len(touchable))
        faces = number[mesh.surface]
        contact = SurfaceContact(
            space.nodes_m[touchable].copy(),
            faces[(faces >= 0).all(axis=1)],
            compliance,
            SphereProbe(BALL_M),
        )
        contact.place(ball_tip(0, SLAB_M[2] + 1e-3), np.eye(3))
        pressed = []

        def tick(
            index: int, contact: SurfaceContact = contact, pressed: list[float] = pressed
        ) -> None:
            pressed.append(float(contact.solve(ball_tip(index), np.eye(3)).force_N[2]))

        times = timed(tick, count=1000, warm_up=210)
        print_result(
            "tissue",
            f"soft step, {prod(cells)} bricks",
            f"{len(mesh.cells)} tetrahedra",
            times,
            PACKAGES,
            value=float(np.median(np.abs(pressed[250:510]))),
            unit="N, press",
        )


def prediction() -> None:
    """Measure the work of pykoop."""
    from tissue.prediction.edmd.dictionary import Delays
    from tissue.prediction.edmd.edmd import Edmd
    from tissue.prediction.edmd.episodes import Episode

    episodes = [Episode(contacts(seed), None, STEP_S) for seed in range(10)]
    unseen, made = contacts(100), {}
    edmd = Edmd(Delays(DELAYS), ridge=1e-8)
    fits = timed(lambda _: made.update(it=edmd.fit(episodes)), count=3)
    matrix, offset = made["it"].predicted_states(HORIZON)[-1]
    seen, far = np.zeros(6 * (DELAYS + 1)), []

    def predict_ahead(tick: int) -> None:
        seen[6:] = seen[:-6]
        seen[:6] = unseen[tick]
        far.append((matrix[5] @ seen + offset[5]) - unseen[tick + HORIZON, 5])

    each = timed(predict_ahead, count=1900, warm_up=50)
    error = float(np.sqrt(np.mean(np.square(far[50:]))))
    observables = f"{6 * (DELAYS + 1)} observables"
    print_result(
        "tissue",
        "fit a predictor",
        f"{10 * len(unseen)} samples, {observables}",
        fits,
        PACKAGES,
        value=error,
        unit="N, RMS error 10 ms ahead",
    )
    print_result(
        "tissue",
        "predict 10 ms ahead",
        observables,
        each,
        PACKAGES,
        value=error,
        unit="N, RMS error 10 ms ahead",
    )


def milling() -> None:
    """Measure the work of mesh booleans: voxel bricks with the cutting force."""
    from meshes.shapes.anatomy import cortical_block
    from meshes.voxels.voxelise import voxelise
    from tissue.cutters.cutter import Cutter
    from tissue.cutters.profile import ball_burr
    from tissue.materials.constants import cutting_coefficients
    from tissue.models.bone.model import BoneModel
    from tissue.models.tissue_model import ToolMotion

    volume = voxelise(cortical_block(size_mm=(1e3 * BLOCK_M,) * 3), spacing_m=SPACING_M)
    burr = Cutter(ball_burr(diameter_m=2 * BURR_M), 6, 1000.0)
    model = BoneModel(volume, burr, (cutting_coefficients("bone"),), cores=1)
    # The block's top is at zero here, its middle elsewhere.
    shift = np.array([0.0, 0.0, -0.5 * BLOCK_M])
    motion = ToolMotion(speed_m_s=FEED_M_S)
    motion.heading[0] = (1.0, 0.0, 0.0)
    motion.tip_m[:] = burr_tip(0) + shift
    model.place(motion)
    carving, removed = [], []

    def tick(index: int) -> None:
        motion.tip_m[:] = burr_tip(index) + shift
        start = process_time()
        model.advance(motion)
        carving.append(process_time() - start)
        model.respond(motion)
        removed.append(float(model.removed_m3.sum()))

    both = timed(tick, count=1000, warm_up=50)
    gone = 1e9 * (removed[-1] - removed[49]) / 1000
    size = f"6 mm ball, {1e3 * SPACING_M:g} mm"
    print_result(
        "tissue", "mill, carve alone", size, carving[50:], PACKAGES, value=gone, unit="mm3 a tick"
    )
    print_result(
        "tissue", "mill, carve and force", size, both, PACKAGES, value=gone, unit="mm3 a tick"
    )


WORKS = {
    "scikit-fem": stiffness,
    "mujoco": soft,
    "pykoop": prediction,
    "manifold": milling,
}

if __name__ == "__main__":
    WORKS[sys.argv[1]]()
