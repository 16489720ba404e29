"""3D view of a run: a window in a script, an interactive view in a notebook, or a still picture."""

import warnings
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from meshes.base.errors import InputError
from meshes.base.extras import install_command
from tissue.simulation.bone_surface import HALF
from tissue.system.offscreen import display_problem
from tissue.system.progress import in_notebook

__all__ = ["show_folder", "with_empty_hidden"]


BACKENDS = ("trame_pyvista", "pyvista.trame.jupyter")
"""Modules of pyvista for interactive views in a notebook, from the extra ``notebook``.

pyvista 0.49 uses the first module, older versions the second one.
"""


def is_interactive() -> bool:
    """Return whether the packages for interactive views in a notebook are installed."""
    for name in BACKENDS:
        with suppress(ImportError), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the second name is an old one
            import_module(name)
            return True
    return False


GHOSTS = "vtkGhostType"
HIDDEN = 32
"""Cell array with which VTK hides cells, and the bit of hidden cells in this array.

The bit is ``vtkDataSetAttributes::HIDDENCELL``.
"""


def with_empty_hidden(data: Any) -> Any:
    """Hide voxels that are less than half full, so filters and pictures ignore these voxels.

    A mesh is returned unchanged.
    """
    if "remaining" in data.cell_data:
        empty = np.asarray(data.cell_data["remaining"]) < HALF
        data.cell_data[GHOSTS] = np.where(empty, HIDDEN, 0).astype(np.uint8)
        data.set_active_scalars("layer", preference="cell")
    return data


def show_folder(
    folder: Path, chosen: dict[str, Any], *, interactive: bool | None, screenshot: Path | None
) -> Any:
    """Show the run of a folder with the chosen time, field, layers and scale.

    See `tissue.objects.run.Run.show`.
    """
    from PIL import Image

    from tissue.show.viewer.run_scene import Choice
    from tissue.show.viewer.view import view

    notebook = in_notebook()
    if interactive is None:
        # A window needs a display, and a notebook needs the packages of the interactive view.
        interactive = screenshot is None and (
            is_interactive() if notebook else display_problem() is None
        )
    elif interactive and screenshot is not None:
        raise InputError(
            "screenshot", "be left out with interactive", screenshot, "leave one of them out"
        )
    if interactive and not notebook:
        view(folder, Choice(**chosen))
        return None
    if interactive and not is_interactive():
        raise InputError(
            "trame",
            "be installed to turn a picture in a notebook",
            "none",
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
    """Return the interactive view for a notebook; this process draws the view."""
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
