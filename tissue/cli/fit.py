"""``tissue fit``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tissue.cli.terminal import console, progress, whole

__all__ = ["fit"]


def fit(
    scene: str,
    /,
    *,
    measured: Path,
    held: Path | None = None,
    out: Path | None = None,
    free: str = "",
    column: Annotated[tuple[str, ...], Parameter(negative="")] = (),
    set_: Annotated[tuple[str, ...], Parameter(name="--set", negative="")] = (),
    nuts: Annotated[bool, Parameter(negative="")] = False,
    cores: Annotated[int | None, Parameter(converter=whole)] = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Find the constants of a scene's material, or of a device, from a measured force log.

    Parameters
    ----------
    scene
        Name of a scene or a TOML file: what was cut or pressed, and by which tool. Of a device device:NAME.
    measured
        Log of poses and forces: .csv, .parquet, .h5, .mat or .npz, a run's own trace among them. Of a device one of it
        free, moved by its motors.
    held
        Of a device: a log of it held, with the measured force on its tip.
    out
        Folder to write; default fits/NAME.
    free
        Constants to find, between commas: cutting.trabecular, cutting.edge, or full names; default the usual ones.
    column
        NAME=COLUMN[:UNIT], where the log has another name or unit, such as force_x_N=-Fx:mN; may be repeated.
    set_
        KEY=VALUE, replaces an entry of the scene; may be repeated.
    nuts
        Draw from the posterior by NUTS too, where a normal law about its maximum may not do; takes minutes.
    cores
        Processor cores to use; default all.
    overwrite
        Replace another fit in the folder.
    """
    from meshes.base.errors import InputError
    from tissue.api.fit import fit as fit_api
    from tissue.fitting.fit_files import FILES
    from tissue.scene.load import load_scene, parse_override
    from tissue.system.owned_folder import require_folder

    overrides = dict(parse_override(text) for text in set_)
    of_device = scene.startswith("device:")
    if of_device and overrides:
        raise InputError("--set must be left out for a device, which has no scene")
    subject = scene if of_device else load_scene(scene, overrides)
    folder = out or Path("fits") / (subject.removeprefix("device:") if isinstance(subject, str) else subject.name)
    require_folder(folder, "fit", FILES, overwrite=overwrite)
    chosen = [name.strip() for name in free.split(",") if name.strip()]
    with progress() as report:
        found = fit_api(
            subject, measured, free=chosen, held=held, columns=column, nuts=nuts, cores=cores, progress=report
        )
        found.save(folder, overwrite=overwrite)
    for sentence in (*found.verdicts, *found.fitted.sentences):
        console.print(sentence)
    then = f"wall --set device={scene.removeprefix('device:')}" if of_device else scene
    console.print(f"files in {folder}; next: tissue run {then} --set materials={folder / 'fitted.toml'}")
