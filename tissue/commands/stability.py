"""``tissue stability``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tissue.commands.terminal import console, problems

__all__ = ["stability"]


def stability(
    scene: str,
    /,
    *,
    set_: Annotated[tuple[str, ...], Parameter(name="--set", negative="")] = (),
    out: Path | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Say whether a scene's device is stable in its hand, and map stiffness against damping and delay.

    Parameters
    ----------
    scene
        Name of a built-in scene or a TOML file.
    set_
        KEY=VALUE, replaces an entry of the scene, such as device=six-dof; may be repeated.
    out
        Folder that takes the picture and the data; without it they are only printed.
    overwrite
        Replace the map that the folder already holds.
    """
    from tissue.load import load_scene, parse_override
    from tissue.stability_report import scene_stability, stability_lines, write_stability_files

    loaded = load_scene(scene, dict(parse_override(text) for text in set_))
    with problems.status("running the loop at many stiffnesses"):
        found = scene_stability(loaded)
    for line in stability_lines(loaded, found):
        console.print(line, soft_wrap=True, highlight=False)
    if out is not None:
        written = write_stability_files(loaded, found, out, overwrite=overwrite)
        console.print(f"files in {out}: {', '.join(path.name for path in written)}", soft_wrap=True, highlight=False)
