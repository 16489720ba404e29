"""trimesh: the same booleans through its own interface, which hands them to manifold3d."""

import trimesh
from works import BLOCK_M, BURR_M, burr_centre, print_result, timed

TICKS = 40


def main() -> None:
    left = {"it": trimesh.creation.box(extents=(BLOCK_M * 1e3,) * 3), "first": 0.0}
    ball = trimesh.creation.icosphere(subdivisions=4, radius=BURR_M * 1e3)

    def tick(index: int) -> None:
        here = ball.copy()
        here.apply_translation(1e3 * burr_centre(index))
        left["it"] = trimesh.boolean.difference(
            [left["it"], here], engine="manifold", check_volume=False
        )
        if index == 0:
            left["first"] = left["it"].volume

    times = timed(tick, count=TICKS)
    gone = (left["first"] - left["it"].volume) / (TICKS - 1)
    print_result(
        "trimesh",
        "mill, carve alone",
        f"6 mm ball, {len(ball.faces)} triangles",
        times[1:],
        "trimesh manifold3d numpy",
        value=gone,
        unit="mm3 a tick",
    )


if __name__ == "__main__":
    main()
