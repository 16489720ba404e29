"""Pictures of a run: functions that draw its results into files."""

from pathlib import Path
from typing import TYPE_CHECKING

from tissue.scene.registry import ANATOMIES

if TYPE_CHECKING:
    from tissue.simulation.run import Run

__all__ = ["draw_pictures"]


def draw_pictures(run: "Run", folder: Path, kind: str = "png") -> list[str]:
    """Draw the pictures of a run as png, svg or pdf.

    ``force_torque`` is drawn for every run. The other pictures depend on the run:

    - ``bone_before_after`` for a tissue of voxels,
    - ``section`` and ``force_depth`` for a rotating tool in voxels of several layers, if the
      tissue, such as a tooth, adds its own values to the trace,
    - ``section`` also for a scene with protected structures (scene key ``keep_clear``),
    - ``press`` and ``held`` for a run with computed fields, such as the displacement of an organ,
    - ``played`` for a run with a device,
    - pictures that the registry of anatomies adds, such as ``insertion``.

    Returns
    -------
    One sentence for each picture that could not be drawn.
    """
    from tissue.show.figures.bone_pictures import draw_before_after
    from tissue.show.figures.force_depth import draw_force_depth, draw_insertion, draw_wall
    from tissue.show.figures.force_time import draw_force_torque, draw_played
    from tissue.show.figures.organ_pictures import draw_held, draw_press
    from tissue.show.figures.section import draw_section

    folder.mkdir(parents=True, exist_ok=True)

    def path(name: str) -> Path:
        return folder / f"{name}.{kind}"

    scene = run.scene
    parts = run.parts
    fields = parts.fields
    notes: dict[str, str | None] = {}
    if parts.volume is not None:
        has_measures = len(parts.tissue.layer_names) > 1 and parts.tissue.measure_names
        # a tool that does not rotate removes nothing, so its section would show nothing new
        is_drilled = bool(has_measures) and run.cutter.spin_rad_s != 0.0
        if is_drilled or parts.keep_clear is not None:
            draw_section(run, path("section"))
        if is_drilled:
            notes["force_depth"] = draw_force_depth(run, path("force_depth"))
    draw_force_torque(run, path("force_torque"))
    if scene.device is not None:
        draw_played(run, path("played"))
    built_in = {"layers": {"insertion": draw_insertion}, "wall": {"wall": draw_wall}}.get(
        scene.anatomy.kind, {}
    )
    for name, draw in {**built_in, **ANATOMIES[scene.anatomy.kind].pictures}.items():
        draw(run, path(Path(name).stem))
    # another process renders in 3D, which takes longest and may fail
    if parts.volume is not None:
        notes["bone_before_after"] = draw_before_after(run, path("bone_before_after"))
    elif fields is not None and fields.frames:
        notes["press"] = draw_press(run, path("press"))
        notes["held"] = draw_held(run, path("held"))
    return [
        f"{name}.{kind} was not drawn: {note}" for name, note in notes.items() if note is not None
    ]
