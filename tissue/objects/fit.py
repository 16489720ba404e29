"""Fit of constants to a measured force: `tissue.fit`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from meshes.base.file_limits import memory_limit
from tissue.fitting.fit import SceneFit, fit_scene
from tissue.fitting.fit_files import verdicts, write_fit
from tissue.fitting.log import read_log
from tissue.scene.scene import Scene
from tissue.system.progress import Bar, reporting

if TYPE_CHECKING:
    import pandas

__all__ = ["Fit", "fit"]


class Fit:
    """Constants of a scene as determined by a log.

    Attributes
    ----------
    fitted
        Complete result of the fit.
    """

    def __init__(self, fitted: SceneFit) -> None:
        self.fitted = fitted

    @property
    def verdicts(self) -> list[str]:
        """Sentences on determined and undetermined constants, and on the next measurement."""
        return verdicts(self.fitted)

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
    """Find the constants of a scene's material from a measured log of poses and forces.

    Parameters
    ----------
    scene
        Scene with the tissue and the tool of the log. The log's poses, in the scene's frame,
        replace its motion.
    measured
        CSV, Parquet, HDF5, .mat or .npz file; a run's own trace needs no columns.
    free
        Constants to find, such as ``cutting.trabecular`` or ``cutting.edge``; by default the usual
        ones.
    columns
        Columns with other names or units: ``{"force_x_N": "-Fx:mN"}``.
    cores
        Processor cores to use; default all.
    max_memory_GB
        Memory that the log may take [GB]; default half of the free memory.
    progress
        Whether to show a progress bar, or a function called with the present work.

    Raises
    ------
    InputError
        If the log cannot be read, the tool never cuts along it, or it determines no constant.
    """
    maps = (
        [f"{name}={column}" for name, column in columns.items()]
        if isinstance(columns, Mapping)
        else list(columns)
    )
    with reporting(progress) as report:
        report("reading the log", 0.0)
        with memory_limit(max_memory_GB):
            log = read_log(Path(measured), maps)
        return Fit(fit_scene(scene, log, free=free, cores=cores, progress=report))
