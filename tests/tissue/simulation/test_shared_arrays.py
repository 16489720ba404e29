"""Arrays that a live run shares with its window.

They are whole for any writer, and updated in turns.
"""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from tissue import load_scene, simulate
from tissue.simulation.live.shared import TURN_TICKS, BoneShared, SharedArrays

ROOT = Path(__file__).parents[3]


def test_an_unfinished_write_is_never_read(tmp_path):
    """An unfinished write is never read.

    Another process writes rows of one number each; a row of mixed numbers would be a torn read.
    """
    layout = {"row": ("float64", (2000,)), "row_turn": ("int64", (1,)), "end": ("int64", (1,))}
    ours = SharedArrays(tmp_path, layout)
    writer = (
        "import sys, time, numpy as np; from pathlib import Path; from "
        "tissue.simulation.live.shared import SharedArrays\n"
        "arrays = SharedArrays(Path(sys.argv[1]))\n"
        "number = 0.0\n"
        "while not arrays['end'][0]:\n    number += 1.0; arrays.write('row', np.full(2000, "
        "number)); time.sleep(1e-4)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", writer, str(tmp_path)], env=os.environ | {"PYTHONPATH": str(ROOT)}
    ):
        seen = set()
        limit = time.perf_counter() + 60.0
        while len(seen) < 50 and time.perf_counter() < limit:
            if (message := ours.read("row")) is not None:
                assert (message[1] == message[1][0]).all()
                seen.add(message[1][0])
            if not seen:
                time.sleep(1e-3)  # it has not begun
        ours["end"][0] = 1
    assert len(seen) == 50


def test_every_brick_is_copied_once_a_turn(tmp_path):
    run = simulate(load_scene("milling", {"voxels.spacing_mm": 0.4, "duration_s": 0.05}))
    milling = run.parts.tissue
    shared = BoneShared(milling, run.volume)
    arrays = SharedArrays(tmp_path, shared.layout)
    shared.publish(arrays, 0)
    left = milling.store.remaining.numpy()
    np.testing.assert_array_equal(arrays["remaining"], left)
    left //= 2
    for index in range(1, TURN_TICKS):
        shared.publish(arrays, index)
    assert (arrays["remaining"] != left).any()
    shared.publish(arrays, TURN_TICKS)
    np.testing.assert_array_equal(arrays["remaining"], left)
