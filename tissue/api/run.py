"""A run as a person holds it: simulated just now or read back from its folder, with the same interface."""

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from tissue.api.html import run_html, run_line
from tissue.api.progress import Bar, reporting
from tissue.api.run_data import RunData
from tissue.api.saved_folder import SavedFolder

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.axes import Axes

    from tissue.uncertainty.band import Band

__all__ = ["Run", "open_run"]


class Run(RunData):
    """A run: what `tissue.simulate` returns, and `tissue.open_run` reads back.

    Parameters
    ----------
    held
        The engine's run, or a run's folder.

    Attributes
    ----------
    path
        Folder in which the run lies; None of one that was not saved yet.
    """

    def plot(self, columns: Iterable[str] | None = None, *, ax: "Axes | None" = None) -> "NDArray[np.object_]":
        """Draw columns of the trace over time, by default force and torque on the tool, with the run's events.

        Parameters
        ----------
        columns
            Columns of numbers, such as ``["removed_mm3", "contact_mm2"]``; those of one unit share a panel.
        ax
            Axes of matplotlib to draw on, for columns of one unit; without it a new figure is made.

        Returns
        -------
        The panels, shape (panels,); ``run.plot()[0].figure`` is the figure.

        Raises
        ------
        InputError
            If there is no such column.
        """
        from tissue.api.plots import plot_columns

        return plot_columns(self.trace, self.events, title=self._title, columns=columns, ax=ax)

    def show(
        self,
        time_s: float | None = None,
        *,
        field: str | None = None,
        hide: tuple[str, ...] = (),
        scale: float = 1.0,
        interactive: bool | None = None,
        screenshot: str | Path | None = None,
    ) -> Any:
        """Show the run in 3D: bone or fields, the tool on its path, and its force.

        Parameters
        ----------
        time_s
            The moment [s]; without it that of the greatest force.
        field
            Field in place of the bone, ``von_mises_MPa`` for one.
        hide
            Layers that are left out.
        scale
            How many times its size the displacement is drawn.
        interactive
            Whether it can be turned by the mouse: in a notebook where the extra ``notebook`` is installed, in a script
            in a window, as `tissue view` opens it, where there is a display. Without it, it is so where it can be.
        screenshot
            PNG file to write; an existing one is replaced.

        Returns
        -------
        A still picture, which a notebook shows, with its pixels as ``array``; in a notebook that can, what is turned by
        the mouse; None of a window, after it was closed.

        Raises
        ------
        InputError
            If there is nothing to show, no such layer, field or moment, no display, or 3D cannot be drawn.
        """
        from tissue.api.show import show_folder

        file = None if screenshot is None else Path(screenshot)
        chosen = {"time_s": time_s, "field": field, "hide": hide, "scale": scale}
        return show_folder(self._folder(), chosen, interactive=interactive, screenshot=file)

    def band(
        self,
        samples: int | None = None,
        *,
        seed: int | None = None,
        workers: int | None = None,
        scheduler: str | None = None,
        each_run: bool = False,
        compute: str = "cpu",
        cores: int | None = None,
        pictures: bool | str = True,
        progress: Bar = None,
    ) -> "Band":
        """Loads and figures over the ranges of the constants, and which constant matters; see docs/guide/bands.md.

        Parameters
        ----------
        samples
            Samples of the constants, rounded up to a power of two; without it the band that was made before is read.
        seed
            Seed of the samples; that of the scene without it.
        workers
            Processes that run samples beside each other, where each is a run of its own, as a needle's is. A script
            that asks for several must begin below ``if __name__ == "__main__":``.
        scheduler
            Address of a Dask scheduler, ``tcp://HOST:PORT`` or ``tls://HOST:PORT``, whose workers run samples instead.
        each_run
            Run every sample where reweighing the loads would do, so that temperature and stress have bands too.
        compute, cores, progress
            As for `tissue.simulate`.
        pictures
            Whether pictures are drawn, or their format, png, svg or pdf; a run that lies in a folder has its band
            written there, another one where it is saved.

        Raises
        ------
        InputError
            If there is no band to read, or none can be made: no constant has a range, the number of samples is none of
            16 to 65536, more than a tenth of them fail, or the run was stopped early.
        """
        if samples is None:
            if self._band is None:
                from tissue.uncertainty.band_files import read_band

                self._band = read_band(self._folder())
            return self._band
        from tissue.uncertainty.band import band_of, require_same

        with reporting(progress) as report:
            made = band_of(
                self.scene, samples, seed=seed, workers=workers, scheduler=scheduler, each_run=each_run,
                compute=compute, cores=cores, progress=report,
            )  # fmt: skip
        require_same(
            made, np.hstack([self.trace.vectors("model_force", "N"), self.trace.vectors("model_torque", "Nm")])
        )
        self._band = made
        self._save_band(pictures)
        return made

    def to_pandas(self) -> "pandas.DataFrame":
        """The trace, a row a tick; the scene's name is in its ``attrs``. See `Trace.to_pandas`."""
        table = self.trace.to_pandas()
        table.attrs["scene"] = self.scene.name
        return table

    def to_xarray(self) -> "xarray.Dataset":
        """The trace over the dimension ``time_s``; the scene's name is in its ``attrs``. See `Trace.to_xarray`."""
        return self.trace.to_xarray().assign_attrs(scene=self.scene.name)

    @property
    def _title(self) -> str:
        return str(self.summary.get("scene", "run"))

    def __repr__(self) -> str:
        return f"<tissue.Run {', '.join(run_line(self.summary))}>"

    def _repr_html_(self) -> str:
        size = np.zeros(0)
        with suppress(InputError):  # of a run that was stopped early there may be no trace
            size = np.linalg.norm(self.trace.vectors("model_force", "N"), axis=1)
        return run_html(self.summary, self.events, size)


def open_run(path: str | Path) -> Run:
    """Read a run back from the folder that it was saved to.

    Parameters
    ----------
    path
        Folder of a run, of one that was stopped, too.

    Raises
    ------
    InputError
        If the folder holds no run, one of another version, or a damaged one.
    """
    return Run(SavedFolder(path))
