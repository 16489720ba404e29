"""Loads and figures of a scene for samples of its constants, one run per sample."""

from collections.abc import Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import Progress
from tissue.fitting.bands.figures import Figure, figures_of
from tissue.fitting.bands.reweighed import with_sizes
from tissue.scene.load import changed
from tissue.scene.scene import Scene
from tissue.simulation.simulate import simulate
from tissue.system.workers import LOST, executor, first_done

__all__ = ["Outcome", "Workers", "reruns"]

Outcome = tuple[Array, dict[Figure, float]] | str
"""Loads, shape (n, 8), and figures of a run; or the reason of its failure."""
PATIENCE_S = 30.0
"""Time that a scheduler may take to answer [s], equal to the value of a study."""
LOST_WORKER = "the process that ran it was lost"
BARREN = 5
"""Consecutive losses without a finished sample after which the workers are abandoned.

The value is equal to the value of a study.
"""


@dataclass(frozen=True)
class Workers:
    """Place where samples run: this process, several local processes or a Dask scheduler."""

    count: int = 1
    scheduler: str | None = None
    compute: str = "cpu"


def reruns(
    scene: Scene, files: tuple[str, ...], *, workers: Workers, report: Progress
) -> Iterator[tuple[int, Outcome]]:
    """Yield the number and the outcome of the run of each file of materials, as each run ends.

    If a worker is lost, its samples are run again, one at a time. A sample that is lost again is
    counted as the cause of the loss.

    Raises
    ------
    InputError
        If no scheduler answers, or workers are lost again and again.
    """
    if workers.count <= 1 and workers.scheduler is None:
        for number, text in enumerate(files):
            report(f"sample {number + 1} of {len(files)}", number / len(files))
            yield number, _outcome(scene, text, workers.compute)
        return
    waiting = list(range(len(files)))
    suspects = list[int]()
    barren = 0
    while waiting or suspects:
        alone = not waiting
        numbers = [suspects.pop(0)] if alone else waiting
        returned = set[int]()
        given = set[int]()
        for number, outcome in _in_pool(scene, files, numbers, workers, report):
            if outcome is None:
                given.add(number)
            else:
                given.remove(number)
                returned.add(number)
                yield number, outcome
        barren = 0 if returned else barren + 1
        if barren > BARREN:
            raise InputError(
                "workers", "stay alive", f"{barren} losses without a sample", "leave workers out"
            )
        if alone:
            yield from ((number, LOST_WORKER) for number in given)
        else:
            suspects += sorted(given)
            waiting = [number for number in waiting if number not in returned | given]


def _in_pool(
    scene: Scene, files: tuple[str, ...], numbers: list[int], workers: Workers, report: Progress
) -> Iterator[tuple[int, Outcome | None]]:
    """Yield outcomes of samples on one pool until it is lost.

    The outcome of a sample is None when it is submitted.
    """
    most = 2 * min(workers.count, len(numbers)) if workers.scheduler is None else len(numbers)
    connected = False
    fresh = iter(numbers)
    running = dict[Future[Outcome], int]()
    try:
        with executor(
            min(workers.count, len(numbers)), workers.scheduler, patience_s=PATIENCE_S
        ) as pool:
            connected = True
            while True:
                while len(running) < most and (number := next(fresh, None)) is not None:
                    running[pool.submit(_outcome, scene, files[number], workers.compute)] = number
                    yield number, None
                if not running:
                    return
                report(f"{len(running)} samples are running", min(running.values()) / len(files))
                for future in first_done(pool, running, report):
                    error = future.exception()
                    number = running[future]
                    if isinstance(error, LOST):
                        raise error
                    del running[future]
                    yield number, future.result() if error is None else _sentence(error)
    except LOST as error:
        if not connected:
            raise InputError(
                "scheduler",
                "answer",
                f"{workers.scheduler} ({error})",
                "start it with `dask scheduler`",
            ) from error
        report("workers were lost, the other samples go on", 0.0)


def _outcome(scene: Scene, file: str, compute: str) -> Outcome:
    """Run one file of materials and return the outcome, including any failure."""
    with TemporaryDirectory(prefix="tissue-band-") as name:
        path = Path(name, "sample.toml")
        path.write_text(file, "utf-8")
        try:
            run = simulate(changed(scene, {"materials": str(path)}), compute=compute, cores=1)
        except InputError as refused:
            return str(refused)
        except Exception as error:
            # a solver that breaks down at one sample is no reason to lose the others
            return _sentence(error)
    trace = run.trace
    loads = with_sizes(
        np.hstack([trace.vectors("model_force", "N"), trace.vectors("model_torque", "Nm")])
    )
    if not np.isfinite(loads).all():
        return "its force is not finite"
    return loads, figures_of(run)


def _sentence(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"
