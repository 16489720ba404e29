"""The stability of a scene's loop before it runs: `tissue stability`."""

from pathlib import Path

from meshes.base.errors import InputError
from tissue.builders.loop import judged_loop
from tissue.evaluation.stability_picture import draw_stability
from tissue.haptics.hand.hand import hand_parameters
from tissue.haptics.loop.critical_stiffness import in_hands
from tissue.haptics.loop.stability_map import StabilityMap, stability_map
from tissue.models.tissue_model import TICK_S
from tissue.scene.registry import DEVICES
from tissue.scene.scene import Scene
from tissue.system.outputs import require_free_folder, write_columns

__all__ = ["scene_stability", "stability_lines", "write_stability_files"]

FILES = ("stability.png", "stability_damping.csv", "stability_delay.csv")


def scene_stability(scene: Scene) -> StabilityMap:
    """Closed-loop stability of a scene's device and operator as a map, about the coupling it would run with.

    Raises
    ------
    InputError
        If the scene has no device.
    """
    if scene.device == "none":
        raise InputError(
            f"device must be one of {', '.join(DEVICES)} for a stability map, got none: pass --set device=touch"
        )
    held = in_hands(judged_loop(scene, step_s=TICK_S), [hand_parameters(scene.hand).grip[:3]])
    return stability_map(held[0])


def stability_lines(scene: Scene, found: StabilityMap) -> list[str]:
    """What a person reads: the verdict, and the boundary over some delays, measured and exact [N/m]."""
    chosen = found.chosen
    data = found.over_delay
    return [
        f"{scene.device} in the hand of a person of the group {scene.hand}, {1e-3 / chosen.tick_s:g} kHz, "
        f"{1e3 * chosen.delay_s:g} ms added to the hold, low-pass {1e3 * chosen.filter_s:g} ms",
        f"chosen: {found.verdict.sentence(chosen.stiffness_N_m)}",
        *(
            f"delay {1e3 * data.values[index]:4.1f} ms: stable below {data.exact_N_m[index]:8.0f} N/m by eigenvalues, "
            f"{data.measured_N_m[index]:8.0f} measured, {data.lines_N_m['passive'][index]:6.0f} passive"
            for index in range(0, len(data.values), 6)
        ),
    ]


def write_stability_files(scene: Scene, found: StabilityMap, folder: Path, *, overwrite: bool) -> list[Path]:
    """Write the picture of a map, and boundaries in N/m over what is varied as ``stability_damping`` and ``_delay``.

    Raises
    ------
    InputError
        If the folder is a file, or holds another map.
    """
    require_free_folder(folder, FILES, "map", overwrite=overwrite)
    folder.mkdir(parents=True, exist_ok=True)
    draw_stability(found, folder / FILES[0], title=f"{scene.name}: {scene.device}, {scene.hand}")
    for name, data in zip(FILES[1:], (found.over_damping, found.over_delay), strict=True):
        lines = {f"{line.replace(' ', '_')}_N_m": values for line, values in data.lines_N_m.items()}
        columns = {data.along: data.values, "measured_N_m": data.measured_N_m, "exact_N_m": data.exact_N_m}
        write_columns(folder / name, columns | lines)
    return [folder / name for name in FILES]
