"""Estimate of the computing time of the trials of a study."""

import os
from collections.abc import Callable, Collection, Iterable
from time import perf_counter

from meshes.base.errors import counted
from tissue.evaluation.study.plan import Plan, TrialKey
from tissue.scene.load import changed, load_scene
from tissue.simulation.simulate import simulate
from tissue.system.progress import duration_text

COSTS = {"T1": 10.0, "T2": 5.1, "T3": 22.0, "needle": 7.6, "reaming": 18.0, "drilling": 12.0}
"""Processor time of a trial per method, relative to the time that `probe_s` returns.

The keys are the tasks. The values were measured by ``python tests/bench/bench_study.py --costs``
with one trial of six methods. Only the value of reaming is 1.49 times the value of drilling, as in
docs/performance.md.
"""
PROBE_S = 0.5
"""Simulated time [s] of the short simulation in `probe_s`."""


def probe_s(clock: Callable[[], float] = perf_counter) -> float:
    """Measure the wall time [s] of a short simulation on this machine."""
    scene = changed(
        load_scene("wall"), {"device.renderer": "penalty", "coupling.stiffness_N_m": 200.0}
    )
    # The first run loads the code.
    simulate(scene.model_copy(update={"duration_s": 0.05}), cores=1)
    begun_s = clock()
    simulate(scene.model_copy(update={"duration_s": PROBE_S}), cores=1)
    return clock() - begun_s


def cost(plan: Plan, keys: Iterable[TrialKey]) -> float:
    """Return the processor time of trials relative to the time that `probe_s` returns."""
    return len(plan.methods) * sum(COSTS[key.task] for key in keys)


def expected_text(plan: Plan, keys: Collection[TrialKey], *, workers: int) -> str:
    """Return a sentence on the expected computing time of trials on this machine."""
    # two processes on two cores are twice as fast as one process
    seconds = probe_s() * cost(plan, keys) / min(workers, os.cpu_count() or 1)
    about = "" if seconds < 60.0 else "about "
    return (
        f"{counted(len(keys), 'trial')} will take {about}{duration_text(seconds)} on "
        f"{counted(workers, 'worker')}, judged by a short simulation"
    )
