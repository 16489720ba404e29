"""Fit of material constants to measured forces: `tissue.fit`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from meshes.base.file_limits import memory_limit
from meshes.base.hints import suggests_arguments
from tissue.fitting.fit import fit_scene, fit_table
from tissue.fitting.fit_files import write_fit
from tissue.fitting.laws import LawMisfit
from tissue.fitting.log import log_of
from tissue.fitting.log_files import read_columns
from tissue.fitting.probe_fit import fit_probes, presses_for
from tissue.fitting.probe_table import is_probe_table
from tissue.fitting.result import Fitted
from tissue.fitting.table import is_table, read_table
from tissue.scene.scene import Scene
from tissue.system.progress import Bar, reporting

if TYPE_CHECKING:
    import pandas


@suggests_arguments
class Fit:
    """Material constants of a scene, fitted to a log of forces or to a table of loads.

    Attributes
    ----------
    fitted
        Result of the fitting code, from which the methods of this class take their values.
    """

    def __init__(self, fitted: Fitted) -> None:
        self.fitted = fitted

    @property
    def verdicts(self) -> list[str]:
        """Sentences on the constants that the data determine, and on helpful measurements."""
        return self.fitted.verdicts

    @property
    def laws(self) -> tuple[LawMisfit, ...]:
        """Misfit of each cutting law to a table of steady loads; empty for other data."""
        return self.fitted.laws

    def to_pandas(self) -> "pandas.DataFrame":
        """Return a table with a row per constant.

        For each constant, the table has the published range, the 5, 50 and 95 % quantiles after the
        fit, and a state such as ``determined``.
        """
        import pandas

        rows = [
            {
                "constant": each.name,
                "cited_low": each.prior.low,
                "cited": each.prior.value,
                "cited_high": each.prior.high,
                "p05": each.low,
                "p50": each.value,
                "p95": each.high,
                "contraction": each.contraction,
                "state": each.state,
            }
            for each in self.fitted.constants
        ]
        return pandas.DataFrame(rows).set_index("constant")

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write the fitted constants, a report, pictures and numbers; return the folder.

        ``fitted.toml`` contains the fitted material constants; a scene reads it through its key
        ``materials``. It is written only if there are such constants. The report gives fitted
        values of scene keys, such as ``organ.young_kPa``, as command-line options.

        Raises
        ------
        InputError
            If the folder holds another fit and `overwrite` is not set.
        """
        write_fit(self.fitted, Path(folder), overwrite=overwrite)
        return Path(folder)

    def __repr__(self) -> str:
        return (
            f"<tissue.Fit of {self.fitted.name} to {self.fitted.path.name}: "
            f"{'; '.join(self.verdicts)}>"
        )


@suggests_arguments
def fit(
    scene: Scene,
    measured: str | Path,
    /,
    *,
    free: Sequence[str] = (),
    columns: Sequence[str] | Mapping[str, str] = (),
    cores: int | None = None,
    max_memory_GB: float | None = None,
    progress: Bar = None,
) -> Fit:
    """Fit the material constants of a scene to a log of measured forces, or to a table of loads.

    A log holds poses and forces over time. A table of steady loads holds the thrust and the torque
    of a drill for each feed and speed. A table of presses holds the force of a ball on tissue for
    each depth. The kind of file is recognised from its columns. For steady loads, the fit also
    reports which cutting laws are incompatible with the table.

    Parameters
    ----------
    scene
        Scene with the tissue and the tool of the measurement. The poses of a log must be in the
        frame of the scene, and replace the motion of the scene.
    measured
        CSV, Parquet, HDF5, .mat or .npz file. If the file is the trace of a run, `columns` is not
        needed. A table of steady loads has the feed: ``feed_mm_per_turn``, or ``spin_rpm`` with
        ``feed_mm_min`` or ``feed_mm_s``. Its loads are ``thrust_N``, and ``torque_Nmm`` or
        ``torque_Nm``. Optional columns are the standard deviations ``thrust_pm_N``, and
        ``torque_pm_Nmm`` or ``torque_pm_Nm``. A table of presses has ``depth_mm``, ``force_N`` and
        optionally ``probe``, the number of the press. For a table of presses, the tool of the scene
        must be the ball, and the anatomy must be a slab with the thickness of the tissue.
    free
        Constants to fit, such as ``cutting.trabecular`` or ``cutting.edge``. The default is all
        constants of the touched tissue that have a published range; see docs/guide/fit.md.
    columns
        Names and units of a log's columns, if they differ from those of a trace. ``{"force_x_N":
        "-Fx:mN"}`` reads the negative of column Fx in mN. A number in place of a name is a constant
        value. ``{"time_s": "500:Hz"}`` gives the sampling rate of a log without times.
    cores
        Processor cores to use; default all.
    max_memory_GB
        Memory that the log may take [GB]; default half of the free memory.
    progress
        Whether to show a progress bar; or a function that is called with the name of the current
        work and its completed share (0 to 1).

    Raises
    ------
    InputError
        If the file cannot be read, if the tool never cuts along the logged path, or if the data
        determine no constant.
    """
    maps = (
        [f"{name}={column}" for name, column in columns.items()]
        if isinstance(columns, Mapping)
        else list(columns)
    )
    path = Path(measured)
    with reporting(progress) as report:
        report("reading the measurement", 0.0)
        with memory_limit(max_memory_GB):
            found = read_columns(path)
            if is_probe_table(found.names, maps):
                presses = presses_for(scene, path, found, maps)
                return Fit(fit_probes(scene, presses, free=free, progress=report))
            if is_table(found.names) and not any(each.startswith("time_s=") for each in maps):
                table = read_table(path, found, maps)
                return Fit(fit_table(scene, table, free=free, progress=report))
            log = log_of(path, found, maps)
        return Fit(fit_scene(scene, log, free=free, cores=cores, progress=report))
