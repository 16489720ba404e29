"""Constants fitted to one's own measured force: `tissue.fit`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from meshes.base.file_limits import memory_limit
from tissue.fitting.fit import SceneFit, fit_scene
from tissue.fitting.fit_files import verdicts, write_fit
from tissue.fitting.log import read_log
from tissue.objects.progress import Bar, reporting
from tissue.scene.scene import Scene

if TYPE_CHECKING:
    import pandas

__all__ = ["Fit", "fit"]


class Fit:
    """What a log determines of a scene's constants.

    Attributes
    ----------
    fitted
        Everything that was found.
    """

    def __init__(self, fitted: SceneFit) -> None:
        self.fitted = fitted

    @property
    def verdicts(self) -> list[str]:
        """What the log determines, what it does not, and what to measure next, in sentences."""
        return verdicts(self.fitted)

    def to_pandas(self) -> "pandas.DataFrame":
        """A row a constant: cited range, 5, 50 and 95 % after the log, and what became of it."""
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
        """Write ``fitted.toml`` for scenes, a report, pictures and numbers; gives the folder.

        Raises
        ------
        InputError
            If the folder holds another fit and `overwrite` is not given.
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
        What was cut or pressed, and by which tool. The log's poses, in the scene's frame, stand for
        its motion.
    measured
        CSV, Parquet, HDF5, .mat or .npz file; a run's own trace needs no columns.
    free
        Constants to find, such as ``cutting.trabecular`` or ``cutting.edge``; by default the usual
        ones.
    columns
        Columns of other names or units: ``{"force_x_N": "-Fx:mN"}``.
    cores
        Processor cores to use; default all.
    max_memory_GB
        Memory that the log may take [GB]; default half of the free memory.
    progress
        Whether a bar is shown, or what is called with what is being done.

    Raises
    ------
    InputError
        If the log cannot be read, the tool never cuts along it, or it determines nothing.
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
