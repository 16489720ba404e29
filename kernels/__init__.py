"""Warp kernels of the simulation, which only read and write arrays.

The kernels do not depend on scenes or meshes. Importing this package starts Warp.
"""

import os
import sys
from pathlib import Path

import warp as wp

from kernels.cache_check import remove_damaged


def _start() -> None:
    """Set the options of Warp, and start Warp without its start message and its GPU warning.

    Warp's messages are not needed, because each simulation run reports its device.
    """
    wp.config.log_level = wp.LOG_WARNING
    # No kernel is differentiated.
    wp.config.enable_backward = False
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
    remove_damaged(Path(wp.config.kernel_cache_dir))


_start()
