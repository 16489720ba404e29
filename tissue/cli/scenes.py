"""``tissue scenes``."""

import sys

from tissue.cli.terminal import console

__all__ = ["scenes"]


def scenes(name: str | None = None, /) -> None:
    """List the named scenes, or print one as TOML, ready to copy and edit.

    Parameters
    ----------
    name
        Scene to print.
    """
    from rich.markup import escape

    from meshes.base.errors import InputError
    from tissue.scene.load import load_scene, scene_names
    from tissue.scene.schema import scene_for_editors

    if name is not None:
        sys.stdout.write(scene_for_editors(name))
        return
    for each in scene_names():
        try:
            description = load_scene(each).description
        except InputError as error:  # from a package, or a missing file: list the other scenes
            description = f"cannot be used: {error}"
        console.print(f"[bold]{each:<12}[/bold] {escape(description)}", markup=True)
