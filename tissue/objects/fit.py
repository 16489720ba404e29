"""Fit of constants to a measured force: `tissue.fit`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from meshes.base.errors import InputError
from meshes.base.file_limits import memory_limit
from tissue.fitting.fit import SceneFit, TableFit, fit_scene, fit_table
from tissue.fitting.fit_files import verdicts, write_fit
from tissue.fitting.laws import LawMisfit
from tissue.fitting.log import log_of
from tissue.fitting.log_files import read_columns
from tissue.fitting.probe_files import probe_verdicts, write_probe_fit
from tissue.fitting.probe_fit import ProbeFit, fit_probes
from tissue.fitting.probe_table import is_probe_table, read_probes
from tissue.fitting.table import is_table, read_table
from tissue.scene.scene import Scene
from tissue.system.progress import Bar, reporting

if TYPE_CHECKING:
    import pandas

__all__ = ["Fit", "fit"]


class Fit:
    """Constants of a scene as determined by a log or a table.

    Attributes
    ----------
    fitted
        Complete result of the fit.
    """

    def __init__(self, fitted: SceneFit | ProbeFit) -> None:
        self.fitted = fitted

    @property
    def verdicts(self) -> list[str]:
        """Sentences on determined and undetermined constants, and on the next measurement."""
        if isinstance(self.fitted, ProbeFit):
            return probe_verdicts(self.fitted)
        return verdicts(self.fitted)

    @property
    def laws(self) -> tuple[LawMisfit, ...]:
        """Misfits of the cutting laws to a table of steady loads; empty for a log."""
        return self.fitted.laws if isinstance(self.fitted, TableFit) else ()

    def to_pandas(self) -> "pandas.DataFrame":
        """Return a table with a row per constant.

        It has the cited range, the 5, 50 and 95 % quantiles given the log, and the state of the
        constant.
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

        Raises
        ------
        InputError
            If the folder holds another fit and `overwrite` is not set.
        """
        if isinstance(self.fitted, ProbeFit):
            write_probe_fit(self.fitted, Path(folder), overwrite=overwrite)
        else:
            write_fit(self.fitted, Path(folder), overwrite=overwrite)
        return Path(folder)

    def __repr__(self) -> str:
        return (
            f"<tissue.Fit of {self.fitted.name} to {self.fitted.path.name}: "
            f"{'; '.join(self.verdicts)}>"
        )


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
    """Find the constants of a scene's material from a measured log, or from steady loads.

    A log holds poses and forces over time. A table of steady loads holds the thrust and the torque
    of a drill by feed and speed. A table of presses holds the force of a ball on tissue by depth.
    The columns of the file show which of them it is. For steady loads, the fit reports which
    cutting laws the table rejects.

    Parameters
    ----------
    scene
        Scene with the tissue and the tool of the log. The log's poses, in the scene's frame,
        replace its motion.
    measured
        CSV, Parquet, HDF5, .mat or .npz file; a run's own trace needs no columns. A table has the
        feed (``feed_mm_min`` or ``feed_mm_s`` with ``spin_rpm``, or ``feed_mm_per_turn``), the
        loads (``thrust_N``, ``torque_Nmm`` or ``torque_Nm``), and possibly their standard
        deviations (``thrust_pm_N``, ``torque_pm_Nmm`` or ``torque_pm_Nm``). Presses have
        ``depth_mm``, ``force_N`` and possibly ``probe``, the number of the press; the scene is a
        slab of the tissue's thickness and a ball.
    free
        Constants to find, such as ``cutting.trabecular`` or ``cutting.edge``; by default the usual
        ones.
    columns
        Columns of a log with other names or units: ``{"force_x_N": "-Fx:mN"}``; a number is a
        constant, and ``{"time_s": "500:Hz"}`` a rate in place of times.
    cores
        Processor cores to use; default all.
    max_memory_GB
        Memory that the log may take [GB]; default half of the free memory.
    progress
        Whether to show a progress bar, or a function called with the present work.

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
                presses = read_probes(path, found, maps)
                return Fit(fit_probes(scene, presses, free=free, progress=report))
            if is_table(found.names) and not any(each.startswith("time_s=") for each in maps):
                _require_own_names(maps)
                table = read_table(path, found)
                return Fit(fit_table(scene, table, free=free, progress=report))
            log = log_of(path, found, maps)
        return Fit(fit_scene(scene, log, free=free, cores=cores, progress=report))


def _require_own_names(maps: Sequence[str]) -> None:
    """Refuse other column names for a table of steady loads."""
    if maps:
        raise InputError(
            "column",
            "be left out for a table of steady loads",
            maps[0],
            "rename the columns in the file",
        )
