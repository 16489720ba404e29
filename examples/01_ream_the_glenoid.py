"""Ream a glenoid 2 mm deep and read the force.

Expected: 234 mm3 of subchondral bone come away, the thrust peaks at 74 N and the torque at 0.76 N m. The figures rest
on cutting coefficients of low confidence (`tissue/materials/cutting.toml`): they are plausible, not validated.
Run: python examples/01_ream_the_glenoid.py [--out DIR]
"""

import sys
from pathlib import Path

import tissue


def main(out: Path | None = None) -> None:
    scene = tissue.load_scene("glenoid")
    run = tissue.simulate(scene)

    removed = run.trace["removed_mm3"][-1]
    thrust, torque = run.trace["model_force_z_N"].max(), run.trace["model_torque_z_Nm"].max()
    print(f"removed {removed:.1f} mm3, peak thrust {thrust:.1f} N, peak torque {torque:.3f} N m")
    print(f"tick: median {run.summary['tick_us']['median']:.0f} us")

    assert abs(removed - 234.4) < 0.5
    assert abs(thrust - 74.1) < 1.0
    assert abs(torque - 0.760) < 0.01
    if out is not None:
        print("files in", run.save(out))


if __name__ == "__main__":
    main(Path(sys.argv[2]) if sys.argv[1:2] == ["--out"] else None)
