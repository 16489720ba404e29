"""MuJoCo: a flex of tetrahedra pressed and stroked by a ball, one step of 1 ms."""

from itertools import product
from math import prod

import mujoco
import numpy as np
from works import BALL_M, POISSON, SLAB_M, SLABS, STEP_S, YOUNG_PA, ball_centre, print_result, timed

KINDS = {"Euler": 0.0, "discrete": 0.01}
"""Integrators and the damping [s] with which they are stable here at 1 ms.

Explicit elasticity needs none, implicit elasticity needs it.
"""


def model_of(cells: tuple[int, ...], integrator: str) -> mujoco.MjModel:
    counts = [cell + 1 for cell in cells]
    spacing = [size / cell for size, cell in zip(SLAB_M, cells, strict=True)]
    nodes = np.stack(np.meshgrid(*[np.arange(n) for n in counts], indexing="ij"), axis=-1).reshape(
        -1, 3
    )
    held = " ".join(str(i) for i in np.flatnonzero(nodes[:, 2] == 0))
    middle = " ".join(f"{0.5 * size}" for size in SLAB_M)
    x, y, z = (str(v) for v in ball_centre(0) + 1e-3 * np.array([0.0, 0.0, 1.0]))
    return mujoco.MjModel.from_xml_string(f"""
    <mujoco>
      <option timestep="{STEP_S}" integrator="{integrator}"/>
      <size memory="200M"/>
      <worldbody>
        <body name="ball" mocap="true" pos="{x} {y} {z}">
          <geom type="sphere" size="{BALL_M}" friction="0.3"/>
        </body>
        <flexcomp name="slab" type="grid" dim="3" count="{counts[0]} {counts[1]} {counts[2]}" pos="{middle}"
                  spacing="{spacing[0]} {spacing[1]} {spacing[2]}" mass="0.4" radius="1e-4">
          <elasticity young="{YOUNG_PA}" poisson="{POISSON}" damping="{KINDS[integrator]}"/>
          <contact selfcollide="none" friction="0.3"/>
          <pin id="{held}"/>
        </flexcomp>
      </worldbody>
    </mujoco>""")


def main() -> None:
    for cells, integrator in product(SLABS, KINDS):
        model = model_of(cells, integrator)
        data = mujoco.MjData(model)
        pressed = []

        def step(tick: int, model=model, data=data, pressed=pressed) -> None:
            data.mocap_pos[0] = ball_centre(tick)
            mujoco.mj_step(model, data)
            force, total = np.zeros(6), 0.0
            for index in range(data.ncon):
                mujoco.mj_contactForce(model, data, index, force)
                total += abs(force[0] * data.contact[index].frame[2])
            pressed.append(total)

        times = timed(step, count=300, warm_up=210)
        print_result(
            f"MuJoCo flex, {integrator}",
            f"soft step, {prod(cells)} bricks",
            f"{model.flex_elemnum[0]} tetrahedra",
            times,
            "mujoco numpy",
            value=float(np.median(pressed[250:])),
            unit="N, press",
        )


if __name__ == "__main__":
    main()
