"""A scene run at all combinations of some values: `tissue.sweep`."""

import json
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import BrokenExecutor, Executor, Future
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from meshes.base.errors import InputError, require_range
from meshes.base.file_version import package_version
from meshes.base.progress import Progress
from meshes.base.text_tables import read_json
from meshes.base.whole_file import whole_file
from tissue.api.progress import Bar, reporting
from tissue.api.simulate import simulate
from tissue.api.sweep_plan import Planned, planned
from tissue.api.sweep_table import FILES, Sweep, SweptRun
from tissue.scene.scene import Scene
from tissue.scene.texts import registered_parts, unknown_parts
from tissue.simulation.run_summary import summary_of
from tissue.system.owned_folder import owned_folder
from tissue.system.workers import first_done, worker_pool

__all__ = ["sweep"]

RECORD = "sweep.json"
FORMAT = 1
"""Version of the record."""
_Left = tuple[Planned, bool]
"""A run that is left, and whether it may replace a run in its folder: one of this sweep, but no other."""
LOST = "the process that ran it was lost: run the sweep again to go on"


@dataclass(frozen=True)
class _Options:
    """How every run is made."""

    compute: str
    cores: int | None
    pictures: bool
    allow_unstable: bool


def sweep(
    scene: Scene | str | Path,
    changes: Mapping[str, Iterable[object]],
    *,
    out: str | Path,
    workers: int = 1,
    compute: str = "cpu",
    cores: int | None = None,
    pictures: bool = False,
    overwrite: bool = False,
    allow_unstable: bool = False,
    progress: Bar = None,
) -> Sweep:
    """Run a scene at all combinations of values; each run has a folder of its own.

    Runs that are there and finished are kept, so that the same call goes on with a sweep that was stopped, and one with
    more values adds theirs. A combination that cannot be run is listed and stops no other one.

    Parameters
    ----------
    scene
        What to simulate; a scene, a built-in name or a TOML file.
    changes
        Values by dotted key: ``{"motion.feed_mm_s": [2.0, 4.0], "tool.spin_rpm": [800, 1200, 1600]}``.
    out
        Folder that takes the runs, and ``sweep.csv``, ``sweep.png`` and ``compare.png``.
    workers
        Processes that run beside each other, each with one core unless ``cores`` states more; then ticks take longer. A
        script that asks for several must begin below ``if __name__ == "__main__":``; they know the parts of installed
        packages, and those that the script registers above that line.
    compute, cores, allow_unstable
        As for `tissue.simulate`.
    pictures
        Whether each run draws its pictures.
    overwrite
        Run finished ones again.
    progress
        Whether a bar is shown, or what is called; without it a notebook shows one.

    Raises
    ------
    InputError
        If no combination makes a scene, the folder holds runs of other scenes under the same names, or several
        processes are asked for with a part that they do not know.
    """
    out = Path(out)
    count = int(require_range("workers", workers, 1, 4096, "use one a core"))
    wanted = planned(scene, changes)
    options = _Options(compute, cores if cores is not None or count == 1 else 1, pictures, allow_unstable)
    with owned_folder(out, "sweep", (), shared=(RECORD, *FILES)), reporting(progress) as report:
        left = _begin(out, wanted, overwrite=overwrite)
        problems = {each.name: each.problem for each in wanted}
        for name, problem in _results(out, left, options, workers=min(count, len(left)), report=report):
            problems[name] = problem
        found = Sweep(
            list(wanted[0].values),
            [SweptRun(each.name, each.values, out / each.name, problems[each.name]) for each in wanted],
        )
        report("drawing pictures", 1.0)
        found.write(out)
    return found


def _begin(out: Path, wanted: list[Planned], *, overwrite: bool) -> list[_Left]:
    """Write down what is run where; return what is left to run.

    Raises
    ------
    InputError
        If a run of another scene lies where one is to lie.
    """
    record = _read(out / RECORD)
    left: list[_Left] = []
    for each in wanted:
        if each.scene is None:
            continue
        text = each.scene.to_toml()
        there = record.get(each.name)
        if there is not None and there != text and not overwrite:
            raise InputError(
                f"out must hold runs of this scene, got another one in {out / each.name}: pass --overwrite to replace "
                "it or choose another --out"
            )
        if overwrite or there != text or summary_of(out / each.name).get("status") != "complete":
            left.append((each, overwrite or there is not None))
        if there is not None or overwrite or not summary_of(out / each.name):
            record[each.name] = text  # a run that lies there and is not of this sweep does not become one of it
    with whole_file(out / RECORD) as temporary:
        data = {"format": FORMAT, "tissue": package_version(), "scenes": record}
        temporary.write_text(json.dumps(data, indent=2) + "\n", "utf-8")
    return left


def _read(path: Path) -> dict[str, str]:
    """Scenes by folder that a sweep wrote down; none where there is no sweep yet."""
    if not path.is_file():
        return {}
    try:
        held: Any = read_json(path.read_text("utf-8"))
        scenes = held["scenes"]
        if held["format"] != FORMAT or not all(isinstance(text, str) for text in scenes.values()):
            raise ValueError(path)
    except (ValueError, LookupError, TypeError, AttributeError):
        raise InputError(
            f"sweep.json must be as a sweep wrote it, got another one in {path}: choose another --out"
        ) from None
    return dict(scenes)


def _results(
    out: Path, left: list[_Left], options: _Options, *, workers: int, report: Progress
) -> Iterator[tuple[str, str]]:
    """Run what is left; names, and what went wrong or nothing, as each comes to its end."""
    total = len(left)
    if workers <= 1:
        for number, (each, replaces) in enumerate(left):
            inner = partial(_share, report, f"run {number + 1} of {total}, {each.name}", number, total)
            yield each.name, _run(each, out / each.name, options, inner, replaces)
        return
    with worker_pool(workers) as pool:
        _require_known(pool, left, workers)
        waiting: dict[Future[str], str] = {
            pool.submit(_run, each, out / each.name, options, False, replaces): each.name for each, replaces in left
        }
        while waiting:
            report(f"{total - len(waiting)} of {total} runs are done", 1.0 - len(waiting) / total)
            for future in first_done(pool, waiting, report):
                error = future.exception()
                if error is not None and not isinstance(error, BrokenExecutor):
                    raise error
                yield waiting.pop(future), LOST if error is not None else future.result()


def _require_known(pool: Executor, left: list[_Left], workers: int) -> None:
    """Refuse parts that were registered in this process alone."""
    registered = registered_parts(each.scene for each, _ in left if each.scene is not None)
    if registered and (missing := pool.submit(unknown_parts, registered).result()):
        raise InputError(
            f"workers must be 1 for parts that are registered in this process alone, got {workers} with the "
            f'{" and the ".join(map(" ".join, missing))}: register them above if __name__ == "__main__": in the '
            "script, or offer them as a package does"
        )


def _share(report: Progress, name: str, number: int, total: int, doing: str, share: float) -> None:
    """Report the share of one run as that of all."""
    report(f"{name}: {doing}", (number + share) / total)


def _run(each: Planned, folder: Path, options: _Options, progress: Bar, replaces: bool) -> str:
    """One run, in its folder; what went wrong, or nothing."""
    assert each.scene is not None
    try:
        run = simulate(
            each.scene,
            compute=options.compute,
            cores=options.cores,
            out=folder,
            overwrite=replaces,
            progress=progress,
            allow_unstable=options.allow_unstable,
        )
        run.save(folder, pictures=options.pictures)
    except InputError as refused:
        return str(refused)
    except Exception as error:
        return f"{type(error).__name__}: {' '.join(str(error).split())}"
    return ""
