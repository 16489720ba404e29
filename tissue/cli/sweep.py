"""``tissue sweep``."""

import csv
import os
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path

from meshes.base.errors import InputError
from meshes.base.text_tables import read_toml
from tissue.cli.terminal import Flag, Formats, MaybeWhole, Overrides, console, print_table, problems
from tissue.system.progress import progress


def sweep(
    scene: str,
    /,
    *,
    set_: Overrides = (),
    out: Path | None = None,
    workers: MaybeWhole = None,
    compute: str = "cpu",
    cores: MaybeWhole = None,
    pictures: Flag = False,
    format_: Formats = (),
    band: MaybeWhole = None,
    overwrite: Flag = False,
    allow_unstable: Flag = False,
) -> None:
    """Run a scene with all combinations of given values; finished runs are kept.

    Parameters
    ----------
    scene
        Name of a built-in scene (see `tissue scenes`) or a TOML file.
    set_
        KEY=VALUE,VALUE: values of a scene key, such as voxels.spacing_mm=0.2,0.4. A comma in
        brackets belongs to a value. May be repeated.
    out
        Folder to write; default sweeps/NAME.
    workers
        Number of parallel processes; default one per core. With one process, each run uses all
        cores.
    compute
        Device that computes the kernels: cpu or cuda:0.
    cores
        Processor cores for each run. The default is one core, or all cores with a single process.
    pictures
        Draw the pictures of each run.
    format_
        Format of the pictures: png, svg or pdf; default png. The formats parquet, npz, mat and h5
        write one table with the traces of all runs. May be repeated.
    band
        Number of samples, such as 200, of the material constants in their published ranges. With
        this option, each run has 50 % and 90 % uncertainty bands.
    overwrite
        Repeat finished runs.
    allow_unstable
        Run even if the coupling between device and tool is unstable.
    """
    from tissue.objects.sweep import sweep as swept
    from tissue.scene.load import load_scene

    changes = parse_values(set_)
    loaded = load_scene(scene)
    folder = out or Path("sweeps") / loaded.name
    with progress() as report:
        report("starting", 0.0)
        found = swept(
            loaded,
            changes,
            out=folder,
            workers=workers or os.cpu_count() or 1,
            compute=compute,
            cores=cores,
            pictures=pictures,
            formats=format_,
            band=band,
            overwrite=overwrite,
            allow_unstable=allow_unstable,
            progress=report,
        )
    titles, rows = found.texts()
    done = f"{loaded.name}: {len(found.finished)} of {len(found.runs)} runs"
    print_table(titles, rows, caption=done)
    for name, problem in found.failures.items():
        problems.print(f"{name}: {problem}")
    for name, note in found.notes.items():
        problems.print(f"note: {name}: {note}")
    console.print(
        f"files in {folder}: "
        f"{', '.join(sorted(path.name for path in folder.iterdir() if path.is_file()))}"
    )
    if found.failures:
        # Scripts must see that runs are missing.
        sys.exit(1)


def parse_values(texts: Sequence[str]) -> dict[str, list[object]]:
    """Parse texts such as ``key=value,value``; return a dict from each key to its values.

    A comma within brackets or quotes belongs to a value.

    Raises
    ------
    InputError
        If there is no ``=``, a value is empty, or a key is repeated.
    """
    from tissue.scene.load import parse_override

    found: dict[str, list[object]] = {}
    for text in texts:
        key, _, listed = text.partition("=")
        key = key.strip()
        try:
            pieces = next(csv.reader([listed], skipinitialspace=True), [])
        except csv.Error:  # such as a line break
            pieces = []
        if not pieces or not all(pieces) or key in found:
            raise InputError(
                "--set",
                "be key=value,value, each key once",
                text,
                "use for example voxels.spacing_mm=0.2,0.4",
            )
        try:
            found[key] = read_toml(f"values = [{listed}]")["values"]
        except tomllib.TOMLDecodeError:  # such as words without quotes
            found[key] = [parse_override(f"{key}={piece}")[1] for piece in pieces]
    return found
