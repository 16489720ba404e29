"""Time to set soft scenes up, kernels compiled: `python tests/bench/bench_build.py`.

Once with an empty cache of computed arrays, once with what that left there.
"""

import os
import tempfile
from time import perf_counter, process_time

from harness import machine, table  # adds the fixtures to the path

from meshes.base.progress import silent
from tissue.models.tissue_model import TICK_S
from tissue.scene.load import load_scene
from tissue.simulation.simulate import build

SCENES = ("needle", "liver-press", "palpation")


def built(name: str) -> list[str]:
    scene = load_scene(name)
    start, busy = perf_counter(), process_time()
    build(scene, step_s=TICK_S, compute="cpu", cores=None, report=silent, allow_unstable=False)
    return [f"{perf_counter() - start:.2f}", f"{process_time() - busy:.2f}"]


def main() -> None:
    print(machine())
    rows = []
    with tempfile.TemporaryDirectory() as compiled, tempfile.TemporaryDirectory() as empty:
        os.environ["TISSUE_CACHE"] = compiled
        for name in SCENES:
            built(name)
        os.environ["TISSUE_CACHE"] = empty
        rows = [[name, *built(name), *built(name)] for name in SCENES]
    print(table(rows, ("scene", "first s", "processor s", "again s", "processor s")))


if __name__ == "__main__":
    main()
