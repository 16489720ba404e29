"""Models of growing size, with the time of a tick and the memory of their arrays."""

import gc
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
import warp as wp
from harness import cost_of, memory_bytes
from peers.works import bricks_in_tetrahedra


@dataclass(frozen=True)
class Point:
    """One size: its median time [us], and the bytes of its arrays."""

    size: float
    time_us: float
    memory: int


Series = Iterator[tuple[str, Point]]


def array_bytes(root: Any) -> int:
    """Bytes of all NumPy and Warp arrays that an object holds on to, each buffer once."""
    seen: set[int] = set()
    buffers: dict[int, int] = {}
    waiting = [root]
    while waiting:
        each = waiting.pop()
        if id(each) in seen or isinstance(
            each, type | types.ModuleType | types.FunctionType | types.FrameType | wp.Kernel
        ):
            continue
        seen.add(id(each))
        if isinstance(each, np.ndarray):
            if each.size:
                buffers[each.__array_interface__["data"][0]] = max(
                    each.nbytes, buffers.get(each.__array_interface__["data"][0], 0)
                )
        elif isinstance(each, wp.array):
            if each.ptr:
                buffers[each.ptr] = max(each.capacity, buffers.get(each.ptr, 0))
        elif type(each).__module__.startswith("warp") and not hasattr(each, "_cls"):
            continue
        if not isinstance(each, str | bytes | int | float):
            waiting += gc.get_referents(each)
    return sum(buffers.values())


def median_us(call: Callable[[int], object], *, count: int, warm_up: int = 2) -> float:
    """The lesser of two medians."""
    return min(cost_of(call, count=count + warm_up, warm_up=warm_up).median for _ in range(2))


def burr_ticks(
    edge_mm: float, spacing_mm: float, shell_m: float | None = None
) -> tuple[Any, float, float]:
    """A ball burr of 2 mm, half of it in a block: model, mean of carving and median of force [us].

    Bricks take turns, so that a median tick carves few of them; the slowest fifth of the ticks is
    left out.
    """
    from meshes.shapes.anatomy import cortical_block
    from meshes.voxels.voxelise import voxelise
    from tissue.cutters.cutter import Cutter
    from tissue.cutters.profile import ball_burr
    from tissue.materials.constants import cutting_coefficients
    from tissue.models.bone.model import BoneModel
    from tissue.models.tissue_model import ToolMotion

    volume = voxelise(cortical_block(size_mm=(edge_mm,) * 3), spacing_m=1e-3 * spacing_mm)
    model = BoneModel(
        volume,
        Cutter(ball_burr(diameter_m=2e-3), 6, 1000.0),
        (cutting_coefficients("bone"),),
        cores=1,
        shell_spacing_m=shell_m,
    )
    motion = ToolMotion(speed_m_s=4e-3)
    motion.heading[0] = (1.0, 0.0, 0.0)
    motion.tip_m[:] = (-1e-3, 0.0, -1e-3)
    model.place(motion)
    carving, forces = [], []
    gc.disable()
    for tick in range(500):
        motion.tip_m[0] = -1e-3 + 4e-6 * tick
        times = [perf_counter()]
        model.advance(motion)
        times.append(perf_counter())
        model.respond(motion)
        times.append(perf_counter())
        carving.append(times[1] - times[0])
        forces.append(times[2] - times[1])
    gc.enable()
    carve = 1e6 * float(np.mean(np.sort(carving[100:])[:320]))
    force = 1e6 * float(np.median(forces[100:]))
    return model, carve, force


def voxels(quick: bool) -> Series:
    """The block grows, the tool stays: a tick must not."""
    for edge in (4.0, 6.4, 9.6) if quick else (4.0, 6.4, 9.6, 14.4, 19.2):
        model, carve, force = burr_ticks(edge, 0.1)
        yield (
            "voxels of the block, tick",
            Point((edge / 0.1) ** 3, carve + force, array_bytes(model)),
        )


def resolution(quick: bool) -> Series:
    """Yield the same block and tool in finer voxels.

    The tick time follows the contact surface, the memory follows the volume.
    """
    for spacing in (0.2, 0.14, 0.1) if quick else (0.25, 0.2, 0.14, 0.1, 0.07, 0.05):
        model, carve, _ = burr_ticks(4.0, spacing, 1e-4)
        yield (
            "voxels of a finer block, carve",
            Point((4.0 / spacing) ** 3, carve, array_bytes(model)),
        )


def shell(quick: bool) -> Series:
    """Elements of the cutter."""
    for spacing in (0.2, 0.1, 0.05) if quick else (0.2, 0.1, 0.05, 0.03, 0.02):
        model, _, force = burr_ticks(4.0, 0.1, 1e-3 * spacing)
        yield (
            "shell points, force",
            Point(len(model.shell.areas_m2), force, array_bytes(model.shell)),
        )


def tetrahedra(quick: bool) -> Series:
    """Assembly, a factor, and multigrid of a clamped cube."""
    from meshes.tets.tetrahedra import TetMesh
    from tissue.fem.assembly import assemble
    from tissue.fem.solvers.direct import DirectSolver
    from tissue.fem.solvers.held_body import HeldBody, held_nodes
    from tissue.fem.solvers.multigrid import MultigridSolver
    from tissue.fem.space import Space
    from tissue.materials.elasticity import lame

    material = lame(5e3, 0.45)
    for cells in (6, 9, 12) if quick else (5, 7, 10, 14, 19, 25):
        mesh = TetMesh(*bricks_in_tetrahedra((1.0, 1.0, 1.0), (cells,) * 3))
        size = len(mesh.cells)
        made: dict[str, Any] = {}

        def structured(_: int, mesh: Any = mesh, made: dict[str, Any] = made) -> None:
            made["space"] = Space(mesh, 1)
            made["K"] = assemble(made["space"], material)

        yield (
            "tetrahedra, assemble",
            Point(size, median_us(structured, count=3), array_bytes((made["space"], made["K"]))),
        )
        space = made["space"]
        load = np.zeros(space.nodes_m.shape)
        load[space.nodes_m[:, 2] > 1.0 - 1e-9, 2] = -1.0
        body = HeldBody(made["K"], space.nodes_m, held_nodes(space.nodes_m[:, 2] < 1e-9))
        if cells < 20:

            def factorised(_: int, body: Any = body, made: dict[str, Any] = made) -> None:
                made["factor"] = DirectSolver(body)

            time_us = median_us(factorised, count=1, warm_up=1 if cells < 12 else 0)
            yield "tetrahedra, factorise", Point(size, time_us, memory_bytes(made["factor"]))

        def solved(_: int, body: Any = body, made: dict[str, Any] = made, load: Any = load) -> None:
            made["grids"] = MultigridSolver(body)
            made["grids"].solve(load)

        yield (
            "tetrahedra, multigrid",
            Point(size, median_us(solved, count=1), memory_bytes(made["grids"])),
        )


def touched(edge_m: float, cells: int) -> Point:
    """Return a ball of 10 mm stroked over a flat surface whose compliance falls with distance.

    A deep body has such a compliance.
    """
    from tissue.models.organ.contact import SurfaceContact
    from tissue.models.organ.probe import SphereProbe

    at = np.linspace(-0.5 * edge_m, 0.5 * edge_m, cells + 1)
    nodes = np.stack(np.meshgrid(at, at, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(nodes)).reshape(cells + 1, cells + 1)
    a, b, c, d = (
        n.ravel() for n in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
    )
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    step = edge_m / cells
    far = np.linalg.norm(nodes[:, None] - nodes[None], axis=2)
    one = 1.0 / (2.0 * np.pi * 5e3) / np.sqrt(far**2 + (0.5 * step) ** 2)
    contact = SurfaceContact(nodes, faces, np.kron(one, np.eye(3)), SphereProbe(0.01))
    contact.place(np.array([0.0, 0.0, 1e-3]), np.eye(3))

    def tick(index: int) -> None:
        contact.solve(
            np.array([max(0, index - 100) * 1e-5, 0.0, -2e-3 * min(1.0, index / 100)]), np.eye(3)
        )

    time_us = cost_of(tick, count=400, warm_up=110).median
    return Point(len(nodes), time_us, array_bytes(contact))


def touchable(quick: bool) -> Series:
    """Nodes that may be touched: more area, then a denser mesh."""
    for cells in (6, 12, 24) if quick else (5, 8, 13, 20, 32, 44):
        yield "touchable nodes, area", touched(4e-3 * cells, cells)
    for cells in (6, 12, 18) if quick else (5, 8, 13, 20, 32, 44):
        yield "touchable nodes, density", touched(0.04, cells)


def particles(quick: bool) -> Series:
    """A ball cuts a block: update, solve and stress of a step."""
    from bench_tooth import FEED_M, SIDE_M, TOLERANCE, body_of

    for cells in (6, 10, 14) if quick else (6, 9, 13, 19, 27):
        body = body_of(cells)
        position, costs = body.particles.position_m, []
        for step in range(8):
            tip = np.array([0.52, 0.47, 1.0]) * SIDE_M - [0.0, 0.0, FEED_M * step]
            hit = np.flatnonzero(np.linalg.norm(position - tip, axis=1) < 0.1 * SIDE_M)
            start = perf_counter()
            body.set_remaining(hit, np.zeros(len(hit), dtype=np.int64))
            body.update()
            body.solve(
                body.spread(tip - [0.0, 0.0, 1e-3], np.array([0.2, 0.0, -1.0])), tolerance=TOLERANCE
            )
            costs.append(perf_counter() - start)
        yield (
            "particles, cut and solve",
            Point(len(position), 1e6 * float(np.median(costs[2:])), array_bytes(body)),
        )


def observables(quick: bool) -> Series:
    """Delays of a predictor of position and force."""
    from peers.works import contacts

    from tissue.prediction.edmd import Edmd, Episode
    from tissue.prediction.operator import Delays

    episodes = [Episode(contacts(seed), None, 1e-3) for seed in range(2)]
    run = episodes[0].states
    for delays in (0, 4, 16) if quick else (0, 1, 4, 9, 24, 49, 99):
        edmd, made = Edmd(Delays(delays), ridge=1e-8), {}

        def fit(_: int, edmd: Any = edmd, made: dict[str, Any] = made) -> None:
            made["it"] = edmd.fit(episodes)

        size = 6 * (delays + 1)
        yield "observables, fit", Point(size, median_us(fit, count=1), array_bytes(made["it"].A))
        matrix, _ = made["it"].predicted_states(4)[-1]
        seen = np.zeros(size)

        def tick(index: int, matrix: Any = matrix, seen: Any = seen) -> None:
            seen[6:] = seen[:-6]
            seen[:6] = run[index]
            matrix @ seen

        yield (
            "observables, tick",
            Point(size, median_us(tick, count=1500, warm_up=100), matrix.nbytes + seen.nbytes),
        )


def ticks(quick: bool) -> Series:
    """Length of a run at the same depth of cut: time of all its ticks, and its tables."""
    from tissue.scene.load import load_scene
    from tissue.simulation.simulate import simulate

    even: dict[str, Any] = {
        "anatomy.size_mm": [60, 12, 6],
        "motion.points_mm": [[-29, 0, -0.2], [29, 0, -0.2]],
        "voxels.spacing_mm": 0.2,
    }
    for seconds in (0.2, 0.6, 2.0) if quick else (0.1, 0.3, 1.0, 3.0, 9.0):
        run = simulate(load_scene("milling", even | {"duration_s": seconds}))
        time_us = float(run.timing["tick_us"].sum())
        yield (
            "ticks of a run, all of them",
            Point(1e3 * seconds, time_us, run.trace.rows.nbytes + run.timing.rows.nbytes),
        )


SERIES = (voxels, resolution, shell, tetrahedra, touchable, particles, observables, ticks)
