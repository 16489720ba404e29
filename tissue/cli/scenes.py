"""``tissue scenes``."""

import sys

from tissue.cli.terminal import console

__all__ = ["scenes"]


def scenes(name: str | None = None, /) -> None:
    """List the built-in scenes, or print one as TOML, ready to copy and edit.

    Parameters
    ----------
    name
        Scene to print.
    """
    from tissue.scene.load import load_scene, scene_names
    from tissue.scene.schema import scene_for_editors

    if name is not None:
        sys.stdout.write(scene_for_editors(name))
        return
    for each in scene_names():
        console.print(f"[bold]{each:<12}[/bold] {load_scene(each).description}", markup=True)
