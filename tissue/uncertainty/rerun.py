"""Loads of a scene for samples of its constants, each by a run of its own."""

from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import Progress
from tissue.materials.prior import Prior
from tissue.scene.load import changed
from tissue.scene.scene import Scene
from tissue.scene.used_constants import used_constants
from tissue.simulation.simulate import simulate
from tissue.system.workers import first_done, worker_pool
from tissue.uncertainty.reweighed import FIGURES, with_sizes
from tissue.uncertainty.sample import Ranges

__all__ = ["Outcome", "ranges_of", "reruns"]

Outcome = tuple[Array, Array] | str
"""Loads, shape (n, 8), and `FIGURES` of a run, shape (4,); or why there are none."""


def ranges_of(scene: Scene, layers: tuple[str, ...]) -> Ranges:
    """Constants with a range on which a scene of such layers rests, but those that it sets itself."""
    used = [one for one in used_constants(scene, layers) if one.stated is None]
    priors = {one.full: Prior.of(one.cited, one.full) for one in used}
    priors = {name: prior for name, prior in priors.items() if not prior.fixed}
    return Ranges(tuple(priors), tuple(priors.values()), scene.constants.correlation(tuple(priors)))


def reruns(
    scene: Scene, files: tuple[str, ...], *, workers: int, compute: str, report: Progress
) -> Iterator[tuple[int, Outcome]]:
    """Number and outcome of the run of each file of materials, as each comes to its end."""
    with TemporaryDirectory(prefix="tissue-band-") as name:
        paths = []
        for number, text in enumerate(files):
            paths.append(Path(name, f"{number}.toml"))
            paths[-1].write_text(text, "utf-8")
        if workers <= 1:
            for number, path in enumerate(paths):
                report(f"sample {number + 1} of {len(paths)}", number / len(paths))
                yield number, _outcome(scene, path, compute)
            return
        with worker_pool(min(workers, len(paths))) as pool:
            waiting: dict[Future[Outcome], int] = {
                pool.submit(_outcome, scene, path, compute): number for number, path in enumerate(paths)
            }
            while waiting:
                left = len(waiting)
                report(f"{len(paths) - left} of {len(paths)} samples are done", 1.0 - left / len(paths))
                for future in first_done(pool, waiting, report):
                    error, number = future.exception(), waiting.pop(future)
                    yield number, future.result() if error is None else f"the process that ran it was lost: {error}"


def _outcome(scene: Scene, file: Path, compute: str) -> Outcome:
    """The run of one file of materials."""
    try:
        run = simulate(changed(scene, {"materials": str(file)}), compute=compute, cores=1)
    except InputError as refused:
        return str(refused)
    trace, summary = run.trace, run.summary
    loads = with_sizes(np.hstack([trace.vectors("model_force", "N"), trace.vectors("model_torque", "Nm")]))
    if not np.isfinite(loads).all():
        return "its force is not finite"
    return loads, np.array([summary[outer][inner] for outer, inner in (name.split(".") for name in FIGURES)])
