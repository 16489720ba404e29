"""Runs of scenes by a hand, for tests."""

import numpy as np

from tissue import load_scene, simulate


def run_of(name, **changes):
    """A run of a scene; double underscores stand for the dots of its keys."""
    allow = changes.pop("allow_unstable", False)
    return simulate(load_scene(name, {k.replace("__", "."): v for k, v in changes.items()}), allow_unstable=allow)


def played_N(run):
    """Size of the force that the device played."""
    return np.linalg.norm(run.trace.vectors("device_force", "N"), axis=1)
