"""Newton: a soft grid pressed and stroked by a ball, one step of 1 ms, by XPBD and by VBD."""

from math import prod

import newton
import numpy as np
import warp as wp
from works import BALL_M, POISSON, SLAB_M, SLABS, STEP_S, YOUNG_PA, ball_centre, print_result, timed

DENSITY = 1000.0


def built(cells: tuple[int, ...]) -> tuple[newton.Model, int]:
    builder = newton.ModelBuilder(gravity=wp.vec3(0.0, 0.0, 0.0))
    spacing = [size / cell for size, cell in zip(SLAB_M, cells, strict=True)]
    builder.add_soft_grid(
        pos=wp.vec3(0.0, 0.0, 0.0),
        rot=wp.quat_identity(),
        vel=wp.vec3(0.0, 0.0, 0.0),
        dim_x=cells[0],
        dim_y=cells[1],
        dim_z=cells[2],
        cell_x=spacing[0],
        cell_y=spacing[1],
        cell_z=spacing[2],
        density=DENSITY,
        k_mu=YOUNG_PA / 2 / (1 + POISSON),
        k_lambda=YOUNG_PA * POISSON / (1 + POISSON) / (1 - 2 * POISSON),
        k_damp=0.1,
        particle_radius=1e-3,
    )
    # The lowest layer of nodes is held, as in the others.
    for index, at in enumerate(builder.particle_q):
        if at[2] < 1e-6:
            builder.particle_mass[index] = 0.0
    at = ball_centre(0)
    ball = builder.add_body(xform=wp.transform(tuple(at), wp.quat_identity()), mass=0.0)
    builder.add_shape_sphere(ball, radius=BALL_M, cfg=newton.ModelBuilder.ShapeConfig(density=0.0))
    builder.color()
    return builder.finalize(device="cpu"), ball


def main() -> None:
    wp.config.quiet = True
    for kind, iterations in (("XPBD", 2), ("VBD", 10)):
        run(SLABS[1], kind, iterations)


def run(cells: tuple[int, ...], kind: str, iterations: int) -> None:
    model, ball = built(cells)
    make = newton.solvers.SolverXPBD if kind == "XPBD" else newton.solvers.SolverVBD
    solver = make(model, iterations=iterations)
    now, after, control = model.state(), model.state(), model.control()
    contacts = model.contacts() if hasattr(model, "contacts") else None
    tops = np.flatnonzero(model.particle_q.numpy()[:, 2] > SLAB_M[2] - 1e-6)

    def step(tick: int) -> None:
        nonlocal now, after
        now.body_q.numpy()[ball, :3] = ball_centre(tick)
        now.clear_forces()
        model.collide(now, contacts)
        solver.step(now, after, control, contacts, STEP_S)
        now, after = after, now

    times = timed(step, count=200, warm_up=210)
    sunk = SLAB_M[2] - float(now.particle_q.numpy()[tops, 2].min())
    print_result(
        f"Newton {kind}, {iterations} iterations",
        f"soft step, {prod(cells)} bricks",
        f"{len(model.tet_indices)} tetrahedra",
        times,
        "newton warp-lang numpy",
        value=1e3 * sunk,
        unit="mm, deepest node",
    )


if __name__ == "__main__":
    main()
