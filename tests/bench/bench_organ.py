"""Cost of pressing an organ at five places: `python tests/bench/bench_organ.py [--edge-mm 4]`.

A bent ellipsoid of a kidney's size with a ball in it, of quadratic tetrahedra, refined at five
places. The first press makes the factor; the last is at a place that nobody expected. Filling the
surface counts only where it is not kept on disk.
"""

import argparse
import resource
from time import perf_counter, process_time

import numpy as np
import pyvista
from harness import machine

import tissue

PLACES = [[-11, 0, -40], [-26, 0, -20], [-30, 0, 0], [-26, 0, 20], [-11, 0, 40]]
ELSEWHERE = [0, 22, 0]


def timed(what, call):
    start, busy = perf_counter(), process_time()
    made = call()
    print(
        f"{what:34s} {perf_counter() - start:7.2f} s, processor {process_time() - busy:7.2f} s",
        flush=True,
    )
    return made


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--edge-mm", type=float, default=4.0)
    edge = parser.parse_args().edge_mm
    print(machine())
    kidney = (
        pyvista.ParametricEllipsoid(30, 22, 55, u_res=50, v_res=50, w_res=50).triangulate().clean()
    )
    kidney.points[:, 0] += 0.006 * kidney.points[:, 2] ** 2
    cyst = pyvista.Sphere(radius=8, center=(-13, 0, 20))
    options = {
        "modulus_kPa": 10,
        "poisson_ratio": 0.49,
        "held": "+x",
        "inclusions": {"cyst": cyst},
        "parts": {"cyst": 40},
    }
    organ = timed("surface to tetrahedra", lambda: tissue.Organ.from_surface(kidney, **options))
    organ = timed("refined at five places", lambda: organ.refined(edge_mm=edge, near_mm=PLACES))
    ball = tissue.ball(diameter_mm=4 * edge)
    timed("stiffness and supports", lambda: organ.soft.body)
    print(
        f"{len(organ.soft.mesh.cells)} quadratic tetrahedra, {len(organ.soft.body.free)} unknowns"
    )
    for place, name in zip(
        [*PLACES, PLACES[0], ELSEWHERE],
        ["first press", *["later"] * 4, "first again", "elsewhere"],
        strict=True,
    ):
        press = timed(name, lambda place=place: organ.press(ball, depth_mm=2.5, at_mm=place))
        print(f"    {press.force_magnitude_N:.4f} N at {np.round(press.at_mm, 1)}")
    print(f"memory {1e-6 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss:.1f} GB")


if __name__ == "__main__":
    main()
