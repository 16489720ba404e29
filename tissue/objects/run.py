"""Simulated run with plots, 3D views and uncertainty bands: `tissue.Run`."""

import warnings
from collections.abc import Iterable
from contextlib import suppress
from functools import cached_property
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.base.extras import install_command
from meshes.base.hints import suggests_arguments
from meshes.base.progress import Progress
from tissue.objects.html import run_html, run_line
from tissue.objects.part_checks import leave_out
from tissue.objects.trace import Trace
from tissue.simulation import run as engine
from tissue.simulation.bone_surface import HALF
from tissue.simulation.run_folder import Summary, picture_format, summary_of
from tissue.system.offscreen import display_problem
from tissue.system.progress import Bar, in_notebook, reporting

if TYPE_CHECKING:
    import pandas
    import pyvista
    import xarray
    from matplotlib.axes import Axes

    from tissue.evaluation.same_task import AssessedRun
    from tissue.fitting.bands.band import Band


@suggests_arguments
class Run(engine.Run):
    """Simulated run, returned by `tissue.simulate` or read by `Run.load`.

    Parameters
    ----------
    simulated
        Result of the simulation engine, without methods for plots and views.

    Attributes
    ----------
    path
        Folder of the run; None before it is saved.
    """

    _band: "Band | None" = None
    _shown: "TemporaryDirectory[str] | None" = None

    def __init__(self, simulated: engine.Run) -> None:
        vars(self).update(vars(simulated))
        self.trace = Trace(simulated.trace)
        self.timing = Trace(simulated.timing)

    @cached_property
    def trace(self) -> Trace:
        """Trace with one row per tick; columns are keyed by name: ``run.trace["force_z_N"]``."""
        return Trace(super().trace)

    @cached_property
    def timing(self) -> Trace:
        """Computing time of each tick and of its stages [µs]: ``run.timing["tick_us"]``."""
        return Trace(super().timing)

    @property
    def summary(self) -> Summary:
        """Values that summarise the run, as in ``summary.json``.

        They include the volume removed from each layer, forces, the computing time of the ticks,
        and the uncertainty band if it was computed.
        """
        return super().summary | ({} if self._band is None else {"band": self._band.summary})

    def dataset(self) -> "pyvista.ImageData | pyvista.UnstructuredGrid":
        """Return the tissue as a pyvista data set, in the frame of the scene [mm].

        For a tissue of voxels, the data set is an image. Its cell arrays are ``layer``,
        ``density_kg_m3``, and the filled fraction of each voxel (255 = full) at the start
        (``start``) and at the end (``remaining``). The cell array ``vtkGhostType`` hides voxels
        that are less than half full, so ``run.dataset().plot()`` shows the bone. For a tissue of
        finite elements, the data set is the mesh with the last saved fields, such as displacement
        and stress.

        Raises
        ------
        InputError
            If the tissue has neither voxels nor finite elements.
        """
        return _with_empty_hidden(super().dataset())

    def surface(self) -> "pyvista.PolyData":
        """Return the surface of the bone after the run [mm].

        The surface has the point array ``removed_depth_mm`` and the cell array ``layer``.

        Raises
        ------
        InputError
            If the tissue has no voxels.
        """
        from tissue.simulation.bone_files import carved_surface

        return carved_surface(self)

    def save(
        self,
        out: str | Path,
        *,
        formats: Iterable[str] = (),
        pictures: bool | str = True,
        overwrite: bool = False,
        progress: Progress | None = None,
    ) -> Path:
        """Write the run, and its uncertainty band if it was computed, to a folder.

        See `tissue.simulation.run.Run.save`.
        """
        path = super().save(
            out, formats=formats, pictures=pictures, overwrite=overwrite, progress=progress
        )
        if self._saved is None:  # the data of a loaded run stay where it was loaded from
            self.path = path
        self._save_band(path, pictures)
        return path

    def _save_band(self, path: Path | None, pictures: bool | str) -> None:
        """Write the uncertainty band into the run's folder, if there are a band and a folder."""
        if self._band is not None and path is not None:
            from tissue.fitting.bands.band import save_band

            save_band(self._band, path, kind=picture_format(pictures))

    def _folder(self) -> Path:
        """Return a folder with the files of this run.

        If the run was saved and its folder still holds it, this folder is returned. Otherwise the
        files are written to a temporary folder.
        """
        if self._saved is not None:
            return self._saved.path
        if self.path is not None and summary_of(self.path) == self.summary:
            return self.path
        if self._shown is None:
            self._shown = TemporaryDirectory(prefix="tissue-", ignore_cleanup_errors=True)
            super().save(self._shown.name, pictures=False)
        return Path(self._shown.name)

    def plot(
        self, columns: Iterable[str] | None = None, *, ax: "Axes | None" = None
    ) -> "NDArray[np.object_]":
        """Plot columns of the trace over time, with the events of the run.

        Parameters
        ----------
        columns
            Names of columns, such as ``["removed_mm3", "contact_mm2"]``; default force and torque
            on the tool. Columns with the same unit share a panel.
        ax
            Matplotlib axes to draw on; possible only if all columns have the same unit. The default
            is a new figure.

        Returns
        -------
        Matplotlib axes, one for each panel, shape (panels,). The figure is
        ``run.plot()[0].figure``.

        Raises
        ------
        InputError
            If a column does not exist.
        """
        from tissue.objects.plots import plot_columns

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
        """Show the run in 3D: tissue, tool, path of the tool, and force on the tool.

        Parameters
        ----------
        time_s
            Time to show [s]; default the time of the largest force.
        field
            Computed field to show instead of the plain tissue, such as ``von_mises_MPa``.
        hide
            Names of layers that are not shown.
        scale
            Factor by which the drawn displacement is multiplied.
        interactive
            Whether the view can be rotated with the mouse. In a notebook, an interactive view needs
            the optional packages of ``tissue[notebook]``. In a script, it needs a display, and
            opens the window of the command `tissue view`. By default, the view is interactive if
            possible, and otherwise a picture.
        screenshot
            PNG file to write; an existing file is replaced.

        Returns
        -------
        In a notebook, an interactive view. In a script with a display: None, once the user has
        closed the window. Otherwise a Pillow image.

        Raises
        ------
        InputError
            If there is nothing to show; if a layer, the field or the time does not exist; if there
            is no display; or if this machine cannot draw in 3D.
        """
        file = None if screenshot is None else Path(screenshot)
        chosen = {"time_s": time_s, "field": field, "hide": hide, "scale": scale}
        return _view_of(self._folder(), chosen, interactive=interactive, screenshot=file)

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
        """Compute uncertainty bands of loads and summary values from ranges of material constants.

        See docs/guide/bands.md.

        Parameters
        ----------
        samples
            Number of random samples of the material constants, rounded up to a power of two. None
            reads the band that the run's folder contains.
        seed
            Seed of the samples; default the seed of the scene.
        workers
            Number of processes that run samples in parallel. `workers` has an effect only if each
            sample needs its own run, as for a needle. A script that uses several processes must
            have its statements below ``if __name__ == "__main__":``.
        scheduler
            Address of a Dask scheduler, ``tcp://HOST:PORT`` or ``tls://HOST:PORT``. Its workers run
            the samples; no processes are started on this machine.
        each_run
            True to run the scene once for every sample. Otherwise the loads of all samples are
            computed from the loads of one run where this is possible. Temperature and stress have
            bands only if each sample is run.
        compute, cores, progress
            As for `tissue.simulate`.
        pictures
            Whether to draw pictures, or the format of the pictures: png, svg or pdf. If the run was
            saved, the band is written into its folder. Otherwise the band is written when the run
            is saved.

        Raises
        ------
        InputError
            If there is no band to read, if no constant has a range, or if the number of samples is
            not from 16 to 65536. It is also raised if more than a tenth of the samples fail, or if
            the run was stopped early.
        """
        if samples is None:
            if self._band is None:
                from tissue.fitting.bands.band import read_band

                self._band = read_band(self._folder())
            return self._band
        from tissue.fitting.bands.band import band_of, require_same

        with reporting(progress) as report:
            made = band_of(
                self.scene,
                samples,
                seed=seed,
                workers=workers,
                scheduler=scheduler,
                each_run=each_run,
                compute=compute,
                cores=cores,
                progress=report,
            )
        require_same(
            made,
            np.hstack(
                [self.trace.vectors("model_force", "N"), self.trace.vectors("model_torque", "Nm")]
            ),
        )
        self._band = made
        self._save_band(self.path, pictures)
        return made

    def to_pandas(self) -> "pandas.DataFrame":
        """Return the trace as a table with one row per tick; ``attrs`` has the name of the scene.

        See `Trace.to_pandas`.
        """
        table = self.trace.to_pandas()
        table.attrs["scene"] = self.scene.name
        return table

    def to_xarray(self) -> "xarray.Dataset":
        """Return the trace as a data set over ``time_s``; ``attrs`` has the name of the scene.

        See `Trace.to_xarray`.
        """
        return self.trace.to_xarray().assign_attrs(scene=self.scene.name)

    @property
    def _title(self) -> str:
        return str(self.summary.get("scene", "run"))

    def __repr__(self) -> str:
        return f"<tissue.Run {', '.join(run_line(self.summary))}>"

    def _repr_html_(self) -> str:
        size = np.zeros(0)
        with suppress(InputError):  # a run that was stopped early may have no trace
            size = np.linalg.norm(self.trace.vectors("model_force", "N"), axis=1)
        return run_html(self.summary, self.events, size)


BACKENDS = ("trame_pyvista", "pyvista.trame.jupyter")
"""Modules with which pyvista shows interactive views in a notebook.

pyvista 0.49 uses the first module, and older versions use the second module. ``tissue[notebook]``
installs them.
"""


def _is_interactive() -> bool:
    """Return whether the packages for interactive views in a notebook are installed."""
    for name in BACKENDS:
        with suppress(ImportError), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the second name is an old one
            import_module(name)
            return True
    return False


GHOSTS = "vtkGhostType"
HIDDEN = 32
"""Bit that marks a hidden cell of VTK, ``vtkDataSetAttributes::HIDDENCELL``.

`GHOSTS` is the name of the cell array that contains this bit.
"""


def _with_empty_hidden(data: Any) -> Any:
    """Hide voxels that are less than half full, so that VTK ignores them.

    A mesh is returned unchanged.
    """
    if "remaining" in data.cell_data:
        empty = np.asarray(data.cell_data["remaining"]) < HALF
        data.cell_data[GHOSTS] = np.where(empty, HIDDEN, 0).astype(np.uint8)
        data.set_active_scalars("layer", preference="cell")
    return data


def _view_of(
    folder: Path, chosen: dict[str, Any], *, interactive: bool | None, screenshot: Path | None
) -> Any:
    """Show the run in a folder with the chosen time, field, layers and scale.

    See `tissue.objects.run.Run.show`.
    """
    from PIL import Image

    from tissue.show.viewer.run_scene import Choice
    from tissue.show.viewer.view import view

    notebook = in_notebook()
    if interactive is None:
        # A window needs a display, and a notebook needs the packages of the interactive view.
        interactive = screenshot is None and (
            _is_interactive() if notebook else display_problem() is None
        )
    elif interactive and screenshot is not None:
        raise InputError(
            "screenshot",
            "be left out with interactive",
            screenshot,
            "remove one of these two arguments",
        )
    if interactive and not notebook:
        view(folder, Choice(**chosen))
        return None
    if interactive and not _is_interactive():
        raise InputError(
            "trame",
            "be installed to rotate a picture in a notebook",
            "a Python environment without it",
            f"run {install_command('notebook')}",
        )
    with TemporaryDirectory(prefix="tissue-") as place:
        file = screenshot or Path(place) / "shown.png"
        # `view` draws in a separate process, which also checks whether this machine can draw.
        view(folder, Choice(**chosen), screenshot=file, overwrite=True)
        with Image.open(file) as picture:
            still = picture.copy()
    return _turned(folder, chosen) if interactive else still


def _turned(folder: Path, chosen: dict[str, Any]) -> Any:
    """Return an interactive view for a notebook."""
    from tissue.show.viewer.run_scene import Choice
    from tissue.show.viewer.window import Window
    from tissue.simulation.run_folder import SavedRun

    saved = SavedRun(folder)
    window = Window(
        saved, str(saved.summary.get("scene", "run")), Choice(**chosen), off_screen=True
    )
    return window.plotter.show(
        jupyter_backend="server", jupyter_kwargs={"collapse_menu": True}, return_viewer=True
    )


@suggests_arguments
def open_run(path: str | Path) -> Run:
    """Read a run from its folder; see `Run.load`."""
    return Run.load(path)


def assessed_run(run: Run | str | Path) -> "AssessedRun":
    """Return the data that `tissue.assess` needs, from a run or from the folder of a run."""
    from tissue.evaluation.same_task import AssessedRun

    run = run if isinstance(run, Run) else Run.load(run)
    scene = None
    with suppress(InputError):  # a run without scene.toml can be assessed too
        scene = run.scene
    return AssessedRun(run.path, run.summary, run.trace, run.status == "complete", scene)


@suggests_arguments
def report(
    run: Run | str | Path,
    out: str | Path | None = None,
    *,
    against: "Run | str | Path | None" = None,
    force_limit_N: float | None = None,
    deviation_limit_mm: float | None = None,
    overshoot_limit_mm: float | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Path:
    """Write a report on a run as one HTML file that needs no network.

    The report shows the summary values and the forces of the run, and a 3D view of the bone or
    organ over time.

    Parameters
    ----------
    run
        Run, or the folder of a saved run.
    out
        HTML file to write; default ``report.html`` in the run's folder.
    against
        Reference run, or its folder. If it is given, the report also contains the assessment of the
        run against it by `tissue.assess`.
    force_limit_N, deviation_limit_mm, overshoot_limit_mm
        With `against`: limits of the force [N], of the distance from the reference path [mm], and
        of the depth below the deepest reference point [mm]. Meaning and defaults are those of
        `tissue.assess`.
    overwrite
        Whether to replace an existing file.
    progress
        Function that is called with the name of the current work and its completed share (0 to 1).

    Returns
    -------
    Path of the file.

    Raises
    ------
    InputError
        If `out` is missing for an unsaved run, if the folder holds no run or damaged files, or if
        the output file exists. It is also raised if anatomy, tool or material of the reference run
        differ from those of the run.
    """
    from tissue.evaluation.assessment_files import assessed_section
    from tissue.show.report.report import NAME, write_report

    found = None
    limits = {
        "force_limit_N": force_limit_N,
        "deviation_limit_mm": deviation_limit_mm,
        "overshoot_limit_mm": overshoot_limit_mm,
    }
    if against is None:
        leave_out(limits, "without a reference run", remedy="give against, or remove this argument")
    else:
        given = {name: value for name, value in limits.items() if value is not None}
        found = assessed_section(assessed_run(run), assessed_run(against), **given)
    if isinstance(run, Run):
        if out is None:
            if run.path is None:
                raise InputError(
                    "out", "be given for a run that was not saved", out, "give the name of a file"
                )
            out = run.path / NAME
        run = run._folder()
    return write_report(run, out, overwrite=overwrite, progress=progress, assessment=found)
