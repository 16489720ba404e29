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
    """Fit the material constants of a scene to measured forces.

    Parameters
    ----------
    scene
        Name of a scene, or a TOML file, with the tissue and the tool of the measurement.
    measured
        File (text, .parquet, .h5, .mat or .npz) of one of three kinds. The first kind is a log of
        poses and forces over time, such as the trace of a run. The second kind is a table of steady
        loads of a drill with the columns thrust_N, torque_Nmm, feed_mm_min and spin_rpm; the fit
        then also reports which cutting laws are incompatible with the table. The third kind is a
        table of presses of a ball on a slab. Its columns are depth_mm, force_N and, optionally,
        probe (the number of the press).
    out
        Output folder; default fits/NAME.
    free
        Constants to fit, separated by commas: groups such as cutting.trabecular and cutting.edge,
        or full names. Default: all constants of the touched tissue that have a published range.
    column
        NAME=COLUMN[:UNIT] assigns a column of the log whose name or unit differs from the trace,
        such as force_x_N=-Fx:mN for the negative of column Fx in mN. NAME=NUMBER sets the quantity
        NAME to a constant value. time_s=RATE:Hz sets the sampling rate of a log without times. May
        be repeated.
    set_
        KEY=VALUE replaces an entry of the scene; may be repeated.
    cores
        Processor cores to use; default all.
    max_memory_GB
        Memory that the log may take, in GB; default half of the free memory.
    overwrite
        Replace the fit that the folder already holds.
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
