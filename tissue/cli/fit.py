"""``tissue fit``."""

from pathlib import Path

from tissue.cli.terminal import (
    Flag,
    MaybeWhole,
    MemoryGB,
    Overrides,
    Texts,
    console,
)
from tissue.system.progress import progress

__all__ = ["fit"]


def fit(
    scene: str,
    /,
    *,
    measured: Path,
    out: Path | None = None,
    free: str = "",
    column: Texts = (),
    set_: Overrides = (),
    cores: MaybeWhole = None,
    max_memory_GB: MemoryGB = None,
    overwrite: Flag = False,
) -> None:
    """Find the constants of a scene's material from a force log, steady loads or presses.

    Parameters
    ----------
    scene
        Name of a scene or a TOML file, with the tissue and the tool of the measurement.
    measured
        Log of poses and forces: text, .parquet, .h5, .mat or .npz, also a run's own trace. Or a
        table of a drill's thrust_N and torque_Nmm by feed_mm_min and spin_rpm: the fit then reports
        which cutting laws it rejects. Or presses of a ball on a slab: depth_mm, force_N, probe.
    out
        Folder to write; default fits/NAME.
    free
        Constants to find, separated by commas: cutting.trabecular, cutting.edge, or full names;
        default the usual ones.
    column
        NAME=COLUMN[:UNIT], if the log has another name or unit, such as force_x_N=-Fx:mN, or
        NAME=NUMBER for a constant, or time_s=RATE:Hz; may be repeated.
    set_
        KEY=VALUE, replaces an entry of the scene; may be repeated.
    cores
        Processor cores to use; default all.
    max_memory_GB
        Memory that the log may take, in GB; default half of the free memory.
    overwrite
        Replace another fit in the folder.
    """
    from tissue.fitting.fit_files import FILES
    from tissue.objects.fit import fit as fit_api
    from tissue.scene.load import load_scene, parse_overrides
    from tissue.system.owned_folder import require_folder

    overrides = parse_overrides(set_)
    subject = load_scene(scene, overrides)
    folder = out or Path("fits") / subject.name
    require_folder(folder, "fit", FILES, overwrite=overwrite)
    chosen = [name.strip() for name in free.split(",") if name.strip()]
    with progress() as report:
        found = fit_api(
            subject,
            measured,
            free=chosen,
            columns=column,
            cores=cores,
            max_memory_GB=max_memory_GB,
            progress=report,
        )
        found.save(folder, overwrite=overwrite)
    for sentence in (*found.verdicts, *found.fitted.sentences):
        console.print(sentence)
    changes = [f"materials={folder / 'fitted.toml'}"] if found.fitted.of_material else []
    changes += [f"{name}={value:.4g}" for name, value in found.fitted.scene_keys.items()]
    console.print(
        f"files in {folder}; next: tissue run {scene} "
        f"{' '.join(f'--set {each}' for each in changes)}"
    )
