"""Pictures of a run: functions that draw its results into files."""

from collections.abc import Callable
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
    - ``section`` and ``force_depth`` for a rotating tool in voxels with several layers, if the
      tissue model (such as the tooth model) adds trace columns,
    - ``section`` also for a scene with protected structures (scene key ``keep_clear``),
    - ``press`` and ``held`` for a run with computed fields, such as the displacement of an organ,
    - ``played`` for a run with a device,
    - pictures that belong to the kind of anatomy, such as ``insertion`` or ``wall``.

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
    scene = run.scene
    parts = run.parts
    fields = parts.fields
    pictures: dict[str, Callable[[Run, Path], object]] = {}
    if parts.volume is not None:
        has_measures = len(parts.tissue.layer_names) > 1 and parts.tissue.measure_names
        # a tool that does not rotate removes nothing, so its section would show nothing new
        is_drilled = bool(has_measures) and run.cutter.spin_rad_s != 0.0
        if is_drilled or parts.keep_clear is not None:
            pictures["section"] = draw_section
        if is_drilled:
            pictures["force_depth"] = draw_force_depth
    pictures["force_torque"] = draw_force_torque
    if scene.device is not None:
        pictures["played"] = draw_played
    if scene.anatomy.kind == "layers":
        pictures["insertion"] = draw_insertion
    elif scene.anatomy.kind == "wall":
        pictures["wall"] = draw_wall
    for name, draw in ANATOMIES[scene.anatomy.kind].pictures.items():
        pictures[Path(name).stem] = draw
    # another process renders in 3D, which takes longest and may fail
    if parts.volume is not None:
        pictures["bone_before_after"] = draw_before_after
    elif fields is not None and fields.frames:
        pictures["press"] = draw_press
        pictures["held"] = draw_held
    notes = []
    for name, draw in pictures.items():
        file = f"{name}.{kind}"
        try:
            reason = draw(run, folder / file)
        # Any exception: the results are complete, and a picture must not make the run fail.
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
        if isinstance(reason, str):
            notes.append(f"{file} was not drawn: {reason}")
    return notes
