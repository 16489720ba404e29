"""The pictures of a run."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from tissue.scene.named_parts import loaded
from tissue.scene.registry import ANATOMIES
from tissue.scene.tool import Needle
from tissue.simulation.depth_map import depth_map
from tissue.simulation.run import Run
from tissue.system.offscreen import end_drawing

__all__ = ["draw_pictures"]


def draw_pictures(run: Run, folder: Path) -> list[str]:
    """Draw a run's pictures: ``force_torque.png`` of every one, the others of what there is.

    Of voxels ``bone_before_after.png`` and ``removed_depth.png``; of a tissue of several layers that reports more than
    its volumes, a tooth for one, also ``section.png`` and ``force_depth.png``. Of fields ``press.png`` and
    ``held.png``; of a run by a hand on a device ``played.png``; and what the tissue has of its own in the table of
    anatomies, ``insertion.png`` for one.

    Returns
    -------
    A sentence for every picture that could not be drawn.
    """
    import matplotlib.figure  # noqa: F401  here, for two threads must not import modules that import each other

    from tissue.figures.before_after import draw_before_after
    from tissue.figures.force_depth import draw_force_depth
    from tissue.figures.held import draw_held
    from tissue.figures.played import draw_played
    from tissue.figures.press import draw_press
    from tissue.figures.section import draw_section
    from tissue.figures.style import draw_force_torque, draw_removed_depth
    from tissue.figures.tool_mesh import tool_surface

    folder.mkdir(parents=True, exist_ok=True)
    scene, parts, fields = run.scene, run.parts, run.parts.fields
    depth = None if parts.volume is None else depth_map(run)
    notes: dict[str, str | None] = {}
    with _background() as pool:
        if depth is not None:
            shaded = pool.submit(draw_before_after, run, depth, folder / "bone_before_after.png")
            draw_removed_depth(run, depth, folder / "removed_depth.png")
            has_measures = len(parts.tissue.layer_names) > 1 and parts.tissue.measure_names
            if has_measures and run.cutter.spin_rad_s != 0.0:
                side = {"axis": depth.axis, "outward": depth.outward}
                draw_section(run, folder / "section.png", **side)
                notes["force_depth.png"] = draw_force_depth(run, folder / "force_depth.png", **side)
            notes["bone_before_after.png"] = shaded.result()
        elif fields is not None and fields.frames:
            shaded = pool.submit(draw_held, fields, folder / "held.png", title=scene.name)
            tool = tool_surface(scene.tool)
            looks = {"title": scene.name, "tool": tool, "flat": isinstance(scene.tool, Needle)}
            notes["press.png"] = draw_press(fields, run.trace, folder / "press.png", **looks)
            notes["held.png"] = shaded.result()
    draw_force_torque(run, folder / "force_torque.png")
    if scene.device != "none":
        draw_played(run, folder / "played.png")
    for name, draw in ANATOMIES[scene.anatomy.kind].pictures.items():
        loaded(draw)(run, folder / name)
    return [f"{name} was not drawn: {note}" for name, note in notes.items() if note is not None]


@contextmanager
def _background() -> Iterator[ThreadPoolExecutor]:
    """A thread that draws in 3D; what ends the block before its end, such as Ctrl-C, does not wait for it."""
    with ThreadPoolExecutor(1) as thread:
        try:
            yield thread
        except BaseException:
            end_drawing()
            raise
