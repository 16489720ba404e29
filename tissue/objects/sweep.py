"""Sweep: a scene run at all combinations of some values: `tissue.sweep`."""

import csv
import json
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor
from functools import partial
from itertools import islice, product
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.errors import InputError, require_range
from meshes.base.file_version import package_version
from meshes.base.progress import Progress
from meshes.base.text_tables import read_json, read_toml
from meshes.base.whole_file import whole_file
from tissue.objects.progress import Bar, reporting
from tissue.objects.simulate import simulate
from tissue.objects.sweep_table import Sweep, SweptRun
from tissue.scene.load import changed, load_scene, parse_override
from tissue.scene.scene import Scene
from tissue.scene.texts import registered_parts, unknown_parts
from tissue.simulation.run_folder import summary_of
from tissue.system.owned_folder import owned_folder
from tissue.system.workers import first_done, worker_pool

__all__ = ["parse_values", "planned", "sweep"]

RECORD = "sweep.json"
FILES = ("sweep.csv", "sweep.png", "compare.png")
"""Files of a sweep in addition to its record and its runs."""
FORMAT = 1
"""Version of the record."""
LONGEST_NAME = 24
"""Largest number of letters of a value in a folder name.

Longer values, and lists, are numbered.
"""
MOST_RUNS = 10_000
"""Largest number of runs of a sweep.

They take three hours at a second each, and their scenes are checked in a minute.
"""
LOST = "the process that ran it was lost: run the sweep again to go on"


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
    """Run a scene at all combinations of values, each run in its own folder.

    Finished runs in the folder are kept. The same call therefore continues a sweep that was
    stopped, and a call with more values adds their runs. A combination that cannot be run is listed
    and does not stop the other runs.

    Parameters
    ----------
    scene
        A scene, a built-in name or a TOML file.
    changes
        Values by dotted key: ``{"motion.feed_mm_s": [2.0, 4.0], "tool.spin_rpm": [800, 1200,
        1600]}``.
    out
        Folder for the runs, and ``sweep.csv``, ``sweep.png`` and ``compare.png``.
    workers
        Number of parallel processes, each with one core unless ``cores`` states more; ticks then
        take longer. A script that uses several must begin below ``if __name__ == "__main__":``. The
        processes have the parts of installed packages, and the parts that the script registers
        above that line.
    compute, cores, allow_unstable
        As for `tissue.simulate`.
    pictures
        Whether each run draws its pictures.
    overwrite
        Run finished runs again.
    progress
        As for `tissue.simulate`.

    Raises
    ------
    InputError
        If no combination makes a scene, the folder holds runs of other scenes under the same names,
        or several processes are requested with a part that they do not have.
    """
    out = Path(out)
    workers = int(require_range("workers", workers, 1, 4096, "use one a core"))
    runs = planned(scene, changes, out)
    if cores is None and workers > 1:
        cores = 1
    run = partial(
        _run, pictures=pictures, compute=compute, cores=cores, allow_unstable=allow_unstable
    )
    with owned_folder(out, "sweep", (), shared=(RECORD, *FILES)), reporting(progress) as report:
        left = _begin(out, runs, overwrite=overwrite)
        problems = dict(_results(run, left, workers=min(workers, len(left)), report=report))
        runs = [
            SweptRun(
                each.name, each.values, each.path, problems.get(each.name, each.problem), each.scene
            )
            for each in runs
        ]
        found = Sweep(list(runs[0].values), runs)
        report("drawing pictures", 1.0)
        found.write(out)
    return found


def planned(
    scene: Scene | str | Path, changes: Mapping[str, Iterable[object]], out: Path
) -> list[SweptRun]:
    """Return the runs of all combinations of values; the last key varies fastest.

    Raises
    ------
    InputError
        If a key has no values, there are more than `MOST_RUNS` combinations, or no combination
        makes a scene.
    """
    listed = {key: _listed(key, values) for key, values in changes.items()}
    count = prod(len(values) for values in listed.values())
    if count > MOST_RUNS:
        raise InputError(
            "a sweep",
            f"have at most {MOST_RUNS} runs",
            f"{count} combinations",
            "give fewer values",
        )
    fixed = {key: values[0] for key, values in listed.items() if len(values) == 1}
    swept = {key: values for key, values in listed.items() if len(values) > 1}
    base = scene if isinstance(scene, Scene) else load_scene(scene)
    named = [
        list(zip(_words(key, values, swept), values, strict=True)) for key, values in swept.items()
    ]
    found: dict[str, SweptRun] = {}
    for combination in product(*named):
        name = ",".join(word for word, _ in combination) or base.name
        values = dict(zip(swept, (value for _, value in combination), strict=True))
        try:
            made = changed(base, fixed | values)
            found[name] = SweptRun(name, values, out / name, scene=made)
        except InputError as refused:
            found[name] = SweptRun(name, values, out / name, str(refused))
    if all(each.problem for each in found.values()):
        raise InputError(next(iter(found.values())).problem)
    return list(found.values())


def parse_values(texts: Sequence[str]) -> dict[str, list[object]]:
    """Parse values by key from ``key=value,value``.

    A comma within brackets or quotes belongs to a value.

    Raises
    ------
    InputError
        If there is no ``=``, a value is empty, or a key is repeated.
    """
    found: dict[str, list[object]] = {}
    for text in texts:
        key, sign, listed = text.partition("=")
        try:
            pieces = next(csv.reader([listed], skipinitialspace=True), [])
        except csv.Error:  # such as a line break
            pieces = []
        try:
            values = read_toml(f"values = [{listed}]")["values"]
        except tomllib.TOMLDecodeError:  # such as words without quotes
            values = [parse_override(f"{key}={piece}")[1] for piece in pieces if piece]
        if not sign or not all(pieces) or not pieces:
            raise InputError(
                "--set", "be key=value,value", text, "use for example voxels.spacing_mm=0.2,0.4"
            )
        key = key.strip()
        if key in found:
            raise InputError(
                "--set", "name a key once", f"{key} twice", "give its values in one, by commas"
            )
        found[key] = values
    return found


def _listed(key: str, values: Iterable[object]) -> list[object]:
    """Return the values of a key as plain Python values, also from NumPy arrays."""
    found: list[object] = []
    if isinstance(values, Iterable) and not isinstance(values, str | Mapping):
        found = list(islice(values, MOST_RUNS + 1))
    if not found:
        raise InputError(key, "be given as a list of values", values, "use for example [1.0, 2.0]")
    return [each.tolist() if isinstance(each, np.generic | np.ndarray) else each for each in found]


def _words(key: str, values: Sequence[object], swept: Mapping[str, object]) -> list[str]:
    """Return parts of folder names for the values of a key.

    A part has the last word of the key, if that is unique, and the value.
    """
    last = key.rpartition(".")[2]
    short = last if sum(other.rpartition(".")[2] == last for other in swept) == 1 else key
    texts = [f"{value:g}" if isinstance(value, float) else str(value) for value in values]
    plain = [re.sub(r"[^\w.+-]+", "-", text) for text in texts]
    nested = any(isinstance(value, list | tuple | dict) for value in values)
    if (
        nested
        or not all(plain)
        or len(set(plain)) < len(plain)
        or max(map(len, plain)) > LONGEST_NAME
    ):
        plain = [f"no{number}" for number in range(1, len(plain) + 1)]
    return [f"{short}={word}" for word in plain]


def _begin(out: Path, runs: list[SweptRun], *, overwrite: bool) -> list[tuple[SweptRun, bool]]:
    """Record the scenes by folder; return the remaining runs.

    Each is returned with whether it may replace a run of this sweep.

    Raises
    ------
    InputError
        If a folder holds a run of another scene.
    """
    record = _read(out / RECORD)
    left: list[tuple[SweptRun, bool]] = []
    for each in runs:
        if each.scene is None:
            continue
        text = each.scene.to_toml()
        recorded = record.get(each.name)
        if recorded not in (None, text) and not overwrite:
            raise InputError(
                "out",
                "hold runs of this scene",
                f"another one in {each.path}",
                "pass --overwrite to replace it or choose another --out",
            )
        summary = summary_of(each.path)
        if overwrite or recorded != text or summary.get("status") != "complete":
            left.append((each, overwrite or recorded is not None))
        if recorded is not None or overwrite or not summary:
            # a run of other origin in the folder does not become part of the sweep
            record[each.name] = text
    with whole_file(out / RECORD) as temporary:
        data = {"format": FORMAT, "tissue": package_version(), "scenes": record}
        temporary.write_text(json.dumps(data, indent=2) + "\n", "utf-8")
    return left


def _read(path: Path) -> dict[str, str]:
    """Read the recorded scenes by folder; empty if there is no sweep yet."""
    if not path.is_file():
        return {}
    try:
        held: Any = read_json(path.read_text("utf-8"))
        scenes = held["scenes"]
        if held["format"] != FORMAT or not all(isinstance(text, str) for text in scenes.values()):
            raise ValueError(path)
    except (ValueError, LookupError, TypeError, AttributeError):
        raise InputError(
            "sweep.json", "be as a sweep wrote it", f"another one in {path}", "choose another --out"
        ) from None
    return dict(scenes)


def _results(
    run: "partial[str]", left: list[tuple[SweptRun, bool]], *, workers: int, report: Progress
) -> Iterator[tuple[str, str]]:
    """Run the remaining runs; yield name and problem of each run that ends.

    The problem is empty for a run without an error.
    """
    total = len(left)
    if workers <= 1:
        for number, (each, replaces) in enumerate(left):
            yield each.name, run(each, replaces, partial(_share, report, each.name, number, total))
        return
    with worker_pool(workers) as pool:
        registered = registered_parts(each.scene for each, _ in left if each.scene is not None)
        if registered and (missing := pool.submit(unknown_parts, registered).result()):
            named = " and the ".join(map(" ".join, missing))
            raise InputError(
                "workers",
                "be 1 for parts that are registered in this process alone",
                f"{workers} with the {named}",
                'register them above if __name__ == "__main__" in the script, or offer them as a '
                "package does",
            )
        waiting = {pool.submit(run, each, replaces, False): each.name for each, replaces in left}
        while waiting:
            report(f"{total - len(waiting)} of {total} runs are done", 1.0 - len(waiting) / total)
            for future in first_done(pool, waiting, report):
                error = future.exception()
                if error is not None and not isinstance(error, BrokenExecutor):
                    raise error
                yield waiting.pop(future), LOST if error is not None else future.result()


def _share(report: Progress, name: str, number: int, total: int, doing: str, share: float) -> None:
    """Report the progress of one run as progress of the sweep."""
    report(f"run {number + 1} of {total}, {name}: {doing}", (number + share) / total)


def _run(each: SweptRun, replaces: bool, progress: Bar, *, pictures: bool, **settings: Any) -> str:
    """Simulate and save one run; return its problem, or an empty text."""
    assert each.scene is not None
    try:
        run = simulate(each.scene, out=each.path, overwrite=replaces, progress=progress, **settings)
        run.save(each.path, pictures=pictures)
    except InputError as refused:
        return str(refused)
    except Exception as error:
        return f"{type(error).__name__}: {' '.join(str(error).split())}"
    return ""
