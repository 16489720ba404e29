"""Which process is writing a run, recorded so that it can be looked for later: a number alone is soon another's."""

import os
import platform
from typing import Any

__all__ = ["identity", "is_alive"]

SAME_S = 5.0
"""Most by which the start of one process may differ between two looks [s]: the clock behind it may be set."""


def identity() -> dict[str, Any]:
    """Number and start [s since 1970] of this process, and the machine it runs on."""
    import psutil

    return {"id": os.getpid(), "started_s": psutil.Process().create_time(), "machine": platform.node()}


def is_alive(process: object) -> bool:
    """Whether a process of that `identity` still runs; one of another machine cannot be looked up, so counts."""
    import psutil

    if not isinstance(process, dict) or "id" not in process:
        return False
    if process.get("machine") != platform.node():
        return True
    try:
        found = psutil.Process(int(process["id"]))
        same = abs(found.create_time() - float(process["started_s"])) < SAME_S
        return same and found.status() != psutil.STATUS_ZOMBIE
    except (psutil.NoSuchProcess, KeyError, TypeError, ValueError):
        return False
    except psutil.AccessDenied:
        return True
