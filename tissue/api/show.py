"""A run in 3D: a window in a script, something to turn by the mouse in a notebook, or else a still picture."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from meshes.base.errors import InputError
from tissue.api.notebook import in_notebook, is_interactive
from tissue.api.picture import Picture
from tissue.simulation.depth_map import HALF
from tissue.system.offscreen import display_problem

__all__ = ["show_folder", "with_empty_hidden"]

GHOSTS, HIDDEN = "vtkGhostType", 32
"""Cell array by which VTK leaves cells out, and its bit for hidden ones (vtkDataSetAttributes::HIDDENCELL)."""


def with_empty_hidden(data: Any) -> Any:
    """Voxels with those that are less than half full hidden from filters and pictures; a mesh as it is."""
    if "remaining" in data.cell_data:
        empty = np.asarray(data.cell_data["remaining"]) < HALF
        data.cell_data[GHOSTS] = np.where(empty, HIDDEN, 0).astype(np.uint8)
        data.set_active_scalars("layer", preference="cell")
    return data


def show_folder(folder: Path, chosen: dict[str, Any], *, interactive: bool | None, screenshot: Path | None) -> Any:
    """Show the run of a folder, with the moment and so on that were chosen; see `tissue.api.run.Run.show`."""
    from tissue.viewer.view import view

    notebook = in_notebook()
    if interactive is None:
        interactive = screenshot is None and (is_interactive() if notebook else display_problem() is None)
    elif interactive and screenshot is not None:
        raise InputError(f"screenshot must be left out with interactive, got {screenshot}: leave one of them out")
    if interactive and not notebook:
        view(folder, **chosen)
        return None
    if interactive and not is_interactive():
        raise InputError(
            "trame must be installed to turn a picture in a notebook, got none: pip install 'tissue-sim[notebook]'"
        )
    with TemporaryDirectory(prefix="tissue-") as place:
        file = screenshot or Path(place) / "shown.png"
        # It draws in a process of its own, and therefore also checks whether this machine can draw.
        view(folder, screenshot=file, overwrite=True, **chosen)
        still = Picture(file.read_bytes())
    return _turned(folder, chosen) if interactive else still


def _turned(folder: Path, chosen: dict[str, Any]) -> Any:
    """What a notebook shows and turns by the mouse, drawn by this process."""
    from tissue.simulation.run_folder import SavedRun
    from tissue.viewer.window import Choice, Window

    saved = SavedRun(folder)
    window = Window(saved, str(saved.summary.get("scene", "run")), Choice(**chosen), off_screen=True)
    return window.plotter.show(jupyter_backend="server", jupyter_kwargs={"collapse_menu": True}, return_viewer=True)
