"""Fit of constants to a measured force: `tissue.fit`."""

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
    """Constants of a scene, as determined from a log or a table.

    Attributes
    ----------
    fitted
        Complete result of the fit.
    """

    def __init__(self, fitted: Fitted) -> None:
        self.fitted = fitted

    @property
    def verdicts(self) -> list[str]:
        """Sentences on the constants that the data determine, on the other constants, and on the
        next measurement.
        """
        return self.fitted.verdicts

    @property
    def laws(self) -> tuple[LawMisfit, ...]:
        """Misfits of the cutting laws to a table of steady loads; empty for a log."""
        return self.fitted.laws

    def to_pandas(self) -> "pandas.DataFrame":
        """Return a table with a row per constant.

        For each constant, the table has the range before the fit (from the source of the constant),
        the 5, 50 and 95 % quantiles after the fit, and a state such as ``determined``.
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
        """Write ``fitted.toml`` for scenes, a report, pictures and numbers; return the folder.

        ``fitted.toml`` is only written if a constant of a material was fitted. The report gives the
        fitted keys of the scene, such as ``organ.young_kPa``, as options.

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
    """Fit the constants of a scene's material to a measured log, or to a table of loads.

    A log holds poses and forces over time. A table of steady loads holds the thrust and the torque
    of a drill for each feed and speed. A table of presses holds the force of a ball on tissue for
    each depth. The kind of file is recognised from its columns. For steady loads, the fit reports
    which cutting laws the table rejects.

    Parameters
    ----------
    scene
        Scene with the tissue and the tool of the log. The poses of the log, in the scene's frame,
        replace the motion of the scene.
    measured
        CSV, Parquet, HDF5, .mat or .npz file. The trace of a run needs no `columns`. A table of
        steady loads has the feed (``feed_mm_min`` or ``feed_mm_s`` with ``spin_rpm``, or
        ``feed_mm_per_turn``), the loads (``thrust_N``, ``torque_Nmm`` or ``torque_Nm``), and
        optionally their standard deviations (``thrust_pm_N``, ``torque_pm_Nmm`` or
        ``torque_pm_Nm``). A table of presses has ``depth_mm``, ``force_N`` and optionally
        ``probe``, the number of the press. The scene for such a table has a ball and a slab that is
        as thick as the tissue.
    free
        Constants to fit, such as ``cutting.trabecular`` or ``cutting.edge``. The default is all
        constants of the touched tissue that have a range; see docs/guide/fit.md.
    columns
        Columns of a log that have other names or units: ``{"force_x_N": "-Fx:mN"}``. A number is a
        constant value. ``{"time_s": "500:Hz"}`` gives a sampling rate if the log has no times.
    cores
        Processor cores to use; default all.
    max_memory_GB
        Memory that the log may take [GB]; default half of the free memory.
    progress
        Whether to show a progress bar, or a function that is called with the name of the current
        work.

    Raises
    ------
    InputError
        If the log or the table cannot be read, the tool never cuts along the log, or the log
        determines no constant.
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
