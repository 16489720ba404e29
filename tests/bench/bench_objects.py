"""Cost of a pose of `tissue.Bone.cut`, compared with a tick of a scene that makes the same cut.

Both run in turn in one process, on the same path and with the same settings. Figures are medians
and 99th percentiles of the ticks [us], and their ratio over the rounds.

Run: python tests/bench/bench_objects.py
"""

import numpy as np

import tissue

ROUNDS = 7
PATH = [[-8, 0, 1], [-8, 0, -1], [4, 2, -1], [4, 4, -1.5]]
BURR = tissue.cutters.ball_burr(diameter_mm=4, flutes=6, spin_rpm=20_000)


def scene_us() -> np.ndarray:
    """Ticks of the scene runner, without writing and drawing."""
    entries = {
        "anatomy.size_mm": [20, 12, 8],
        "tool.kind": "ball-burr",
        "tool.diameter_mm": 4.0,
        "tool.flutes": 6,
        "tool.spin_rpm": 20_000,
        "motion.points_mm": PATH,
        "motion.feed_mm_s": 5.0,
        "duration_s": 3.0,
        "voxels.spacing_mm": 0.1,
        "tool.shell_spacing_mm": 1e3 * (BURR.cutting_area_m2 / 6000) ** 0.5,
    }
    return np.asarray(tissue.simulate(tissue.load_scene("milling", entries)).timing["tick_us"])


def cut_us() -> np.ndarray:
    """Poses of a cut."""
    tips, times = tissue.feed_along(PATH, feed_mm_s=5.0)
    return (
        tissue.Bone.block((20, 12, 8), spacing_mm=0.1).cut(BURR, tips[:3000], times[:3000]).pose_us
    )


def main() -> None:
    scene_us(), cut_us()  # compile, warm up
    rounds = [(scene_us(), cut_us()) for _ in range(ROUNDS)]
    rows = np.array(
        [
            [[np.median(us), np.percentile(us, 99), us.sum() / len(us)] for us in pair]
            for pair in rounds
        ]
    )
    for name, scene, cut in zip(("median", "99 %", "mean"), *np.median(rows, axis=0), strict=True):
        print(f"{name}: tick {scene:.0f} us, pose {cut:.0f} us")
    ratios = rows[:, 1, 0] / rows[:, 0, 0]
    print(
        f"pose over tick, medians: {np.median(ratios):.2f} "
        f"({ratios.min():.2f}-{ratios.max():.2f} of {ROUNDS} rounds)"
    )


if __name__ == "__main__":
    main()
