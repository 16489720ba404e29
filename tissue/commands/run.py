"""``tissue run``."""

from pathlib import Path
from time import perf_counter
from typing import Annotated

from cyclopts import Parameter

from tissue.commands.terminal import console, progress, whole

__all__ = ["run"]


def run(
    scene: str,
    /,
    *,
    out: Path | None = None,
    seed: Annotated[int | None, Parameter(converter=whole)] = None,
    duration_s: float | None = None,
    set_: Annotated[tuple[str, ...], Parameter(name="--set", negative="")] = (),
    compute: str = "cpu",
    cores: Annotated[int | None, Parameter(converter=whole)] = None,
    format_: Annotated[tuple[str, ...], Parameter(name="--format", negative="")] = (),
    pictures: bool = True,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    allow_unstable: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Simulate a scene and write its trace, bone and pictures.

    Parameters
    ----------
    scene
        Name of a built-in scene (see `tissue scenes`) or a TOML file.
    out
        Folder to write; default runs/NAME.
    seed
        Seed of every random draw.
    duration_s
        Simulated time in seconds.
    set_
        KEY=VALUE, replaces an entry of the scene, such as voxels.spacing_mm=0.2; may be repeated.
    compute
        Device for the kernels: cpu or cuda:0.
    cores
        Processor cores to use; default all. The trace does not depend on it.
    format_
        Further formats of the trace beside CSV: parquet, npz, mat, h5; may be repeated.
    pictures
        Draw pictures.
    overwrite
        Replace the run that the folder already holds.
    allow_unstable
        Run a device whose coupling is judged unstable, too.
    """
    from tissue.formats import check_formats
    from tissue.load import load_scene, parse_override
    from tissue.run_folder import RunFolder

    check_formats(format_)
    overrides = dict(parse_override(text) for text in set_)
    if seed is not None:
        overrides["seed"] = seed
    if duration_s is not None:
        overrides["duration_s"] = duration_s
    loaded = load_scene(scene, overrides)
    folder = out or Path("runs") / loaded.name
    RunFolder.check(folder, overwrite=overwrite)
    started = perf_counter()
    with progress() as tell:
        tell("starting Warp", 0.0)
        from tissue.simulation import simulate
        from tissue.summary_table import print_summary

        finished = simulate(
            loaded,
            compute=compute,
            cores=cores,
            out=folder,
            overwrite=overwrite,
            progress=tell,
            allow_unstable=allow_unstable,
        )
        simulated = perf_counter()
        finished.save(folder, formats=format_, pictures=pictures, progress=tell)
    print_summary(
        console, finished.summary(), folder, wall_s=perf_counter() - started, saving_s=perf_counter() - simulated
    )
