"""The pictures of a run."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from tissue.simulation.depth_map import depth_map
from tissue.simulation.run import Run
from tissue.system.offscreen import end_drawing

if TYPE_CHECKING:
    pass

__all__ = ["draw_pictures"]


def draw_pictures(run: Run, folder: Path) -> list[str]:
    """Draw ``bone_before_after.png``, ``removed_depth.png`` and ``force_torque.png``.

    A soft organ has ``press.png`` and ``held.png`` in place of the first two, a needle ``insertion.png`` as well and a
    wall ``wall.png``. Of a tissue of several layers that reports more than its volumes, a tooth for one, also
    ``section.png`` and ``force_depth.png``; of a run by a hand on a device ``played.png``.

    Returns
    -------
    A sentence for every picture that could not be drawn.
    """
    from tissue.figures.before_after import draw_before_after
    from tissue.figures.force_depth import draw_force_depth
    from tissue.figures.held import draw_held
    from tissue.figures.insertion import draw_insertion
    from tissue.figures.played import draw_played
    from tissue.figures.press import draw_press
    from tissue.figures.section import draw_section
    from tissue.figures.style import draw_force_torque, draw_removed_depth
    from tissue.figures.tool_mesh import tool_surface
    from tissue.figures.wall import draw_wall

    folder.mkdir(parents=True, exist_ok=True)
    notes: dict[str, str | None] = {}
    if run.scene.device != "none":
        draw_played(run, folder / "played.png")
    if run.parts.volume is None:
        with _background() as pool:
            if (fields := run.parts.fields) and fields.frames:
                tool, name = tool_surface(run.scene.tool), run.scene.name
                held = pool.submit(draw_held, fields, folder / "held.png", title=name)
                notes["press.png"] = draw_press(fields, run.trace, folder / "press.png", title=name, tool=tool)
                notes["held.png"] = held.result()
            draw_force_torque(run, folder / "force_torque.png")
            if run.scene.tool.kind == "needle":
                draw_insertion(run, folder / "insertion.png")
            if run.scene.anatomy.kind == "wall":
                draw_wall(run, folder / "wall.png")
        return _sentences(notes)
    depth = depth_map(run)
    with _background() as pool:
        render = pool.submit(draw_before_after, run, depth, folder / "bone_before_after.png")
        draw_removed_depth(run, depth, folder / "removed_depth.png")
        draw_force_torque(run, folder / "force_torque.png")
        has_measures = len(run.parts.tissue.layer_names) > 1 and run.parts.tissue.measure_names
        if has_measures and run.cutter.spin_rad_s != 0.0:
            side = {"axis": depth.axis, "outward": depth.outward}
            draw_section(run, folder / "section.png", **side)
            notes["force_depth.png"] = draw_force_depth(run, folder / "force_depth.png", **side)
        notes["bone_before_after.png"] = render.result()
    return _sentences(notes)


@contextmanager
def _background() -> Iterator[ThreadPoolExecutor]:
    """A thread that draws in 3D; what ends the block before its end, such as Ctrl-C, does not wait for it."""
    with ThreadPoolExecutor(1) as thread:
        try:
            yield thread
        except BaseException:
            end_drawing()
            raise


def _sentences(notes: dict[str, str | None]) -> list[str]:
    """A sentence for every picture that could not be drawn."""
    return [f"{name} was not drawn: {note}" for name, note in notes.items() if note is not None]
