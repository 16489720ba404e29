"""Build a scene's motion and tissue by the tables of `tissue.scene.registry`."""

from meshes.base.errors import InputError
from meshes.base.progress import Progress
from tissue.scene.registry import ANATOMIES
from tissue.scene.scene import Scene
from tissue.simulation.builders.motions import motion_of
from tissue.simulation.builders.own_constants import note_own_constants
from tissue.simulation.builders.parts import Parts, TissueBuilder

__all__ = ["build", "builder_of"]


def build(
    scene: Scene,
    *,
    step_s: float,
    compute: str,
    cores: int | None,
    report: Progress,
    allow_unstable: bool = False,
) -> Parts:
    """Build the parts of a scene.

    Raises
    ------
    InputError
        If a file cannot be used, something would not fit memory, the tool never touches, there is
        no such device, or its coupling is unstable and that is not allowed.
    """
    _require_device(compute)
    motion = motion_of(scene, step_s=step_s)
    tissue = builder_of(scene.anatomy.kind)
    if scene.device is None:
        parts = tissue(scene, motion, step_s=step_s, compute=compute, cores=cores, report=report)
        note_own_constants(scene, parts.tissue.layer_names, parts.notes)
        return parts
    from tissue.simulation.builders.hand import hand_motion

    held, note = hand_motion(scene, motion, step_s=step_s, allow_unstable=allow_unstable)
    parts = tissue(scene, held, step_s=step_s, compute=compute, cores=cores, report=report)
    parts.notes["coupling"] = note
    note_own_constants(scene, parts.tissue.layer_names, parts.notes)
    return parts


def builder_of(kind: str) -> TissueBuilder:
    """Return the function that builds the parts of a run, by the kind of its anatomy."""
    from tissue.simulation.builders import cutting, organ_scene

    outside: TissueBuilder | None = ANATOMIES[kind].build
    if outside is not None:
        return outside
    others = {
        "slab": organ_scene.pressed,
        "liver": organ_scene.pressed,
        "layers": organ_scene.pierced,
    }
    return (others | {"wall": organ_scene.wall}).get(kind, cutting.milled)


def _require_device(compute: str) -> None:
    """Refuse a compute device that does not exist; the processor always exists."""
    if compute == "cpu":
        return
    import warp as wp

    known = [str(device) for device in wp.get_devices()]
    if compute not in known:
        raise InputError("compute", f"be one of {', '.join(known)}", compute, "use cpu here")
