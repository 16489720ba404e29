"""A saved run in a window, or as a screenshot: the bone, the tool on its path, and its force."""

import sys
from pathlib import Path

from meshes.errors import InputError
from tissue.offscreen import display_problem, draw_apart
from tissue.run_folder import SavedRun
from tissue.viewer import scene_of, show
from tissue.viewer_fields import field_names

__all__ = ["view"]


def view(
    path: str | Path, *, screenshot: Path | None = None, hide: tuple[str, ...] = (), field: str | None = None
) -> str:
    """Show a run, or draw it into a file.

    Parameters
    ----------
    path
        Folder that `tissue run` wrote, of a run that ended or was stopped.
    screenshot
        PNG file to write instead of opening a window; an existing one is replaced.
    hide
        Layers that are switched off at first.
    field
        Field that is shown at first in place of the bone, ``von_mises_MPa`` for one.

    Returns
    -------
    What was shown, in a sentence or two.

    Raises
    ------
    InputError
        If the folder holds no run, there is no such layer or field, no display for a window, or the picture cannot be
        drawn.
    """
    saved = SavedRun(path)
    said = _about(saved)
    _check(saved, hide, field)
    if screenshot is None:
        problem = display_problem()
        if problem is not None:
            raise InputError(f"view must have a display to open a window, but {problem}: pass --screenshot FILE")
        show(saved, said, hide=hide, field=field)
        return said
    if screenshot.suffix.lower() != ".png":
        raise InputError(f"screenshot must be a .png file, got {screenshot}: use {screenshot.with_suffix('.png')}")
    if not screenshot.absolute().parent.is_dir():
        raise InputError(f"screenshot must lie in an existing folder, got {screenshot}: make the folder first")
    screenshot.open("ab").close()
    problem = draw_apart("tissue.view", str(saved.path), str(screenshot), field or "", *hide)
    if problem is not None:
        if screenshot.stat().st_size == 0:
            screenshot.unlink()
        raise InputError(f"screenshot must be drawn in 3D, but {problem}")
    return f"{said}\nscreenshot in {screenshot}"


def _check(saved: SavedRun, hide: tuple[str, ...], field: str | None) -> None:
    """Refuse names that the run does not have."""
    layers = saved.summary.get("layers", [])
    for name in hide:
        if name not in layers:
            raise InputError(f"hide must name a layer of the run, got {name}: use one of {', '.join(layers)}")
    if field is not None and field not in (fields := field_names(saved.path)):
        known = f"use one of {', '.join(fields)}" if fields else "this run has none, leave it out"
        raise InputError(f"field must name a field of the run, got {field}: {known}")


def _about(saved: SavedRun) -> str:
    """What there is to see."""
    if saved.complete:
        force, torque = saved.summary["force_N"]["peak"], saved.summary["torque_Nm"]["peak"]
        seconds = saved.summary["simulated_s"]
        return f"{saved.summary['scene']}: {seconds:g} s, force up to {force:.3g} N, torque up to {torque:.3g} N·m"
    if saved.trace is None or not len(saved.trace.rows):
        return "run is incomplete: it stopped before its first tick was written"
    last = float(saved.trace["time_s"][-1])
    planned = _planned_s(saved)
    return f"run is incomplete: it stopped at {last:.3f} s" + (f" of {planned:g} s" if planned else "")


def _planned_s(saved: SavedRun) -> float | None:
    """How long a run was meant to last [s]."""
    from tissue.build import motion_of

    scene = scene_of(saved)
    if scene is None:
        return None
    try:
        return scene.duration_s or motion_of(scene, step_s=1e-3).duration_s
    except InputError:
        return None


if __name__ == "__main__":
    finished = SavedRun(sys.argv[1])
    png, shown, *hidden = sys.argv[2:]
    show(finished, _about(finished), Path(png), hide=tuple(hidden), field=shown or None)
