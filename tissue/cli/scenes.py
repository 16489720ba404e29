"""``tissue scenes`` and ``tissue schema``."""

import sys
from pathlib import Path

from meshes.base.errors import InputError
from tissue.cli.terminal import Flag, console, left_out


def scenes(name: str | None = None, /, *, out: Path | None = None, overwrite: Flag = False) -> None:
    """List the names of available scenes, or print one scene as TOML for copying and editing.

    Parameters
    ----------
    name
        Name of the scene to print.
    out
        File to write instead of printing the scene.
    overwrite
        Replace an existing file.
    """
    from rich.markup import escape

    from tissue.scene.load import load_scene, scene_names
    from tissue.scene.texts import scene_for_editors

    if name is not None:
        _print_or_write(scene_for_editors(name), out, overwrite=overwrite)
        return
    left_out("without a scene", "name a scene first", out=out, overwrite=overwrite)
    for each in scene_names():
        try:
            description = load_scene(each).description
        except InputError as error:  # from a package, or a missing file: list the other scenes
            description = f"cannot be used: {error}"
        console.print(f"[bold]{each:<12}[/bold] {escape(description)}", markup=True)


def schema(*, out: Path | None = None, overwrite: Flag = False) -> None:
    """Print the JSON schema of scene files, which editors use to complete and check keys.

    Parameters
    ----------
    out
        File to write instead of printing the schema.
    overwrite
        Replace an existing file.
    """
    from tissue.scene.texts import schema_text

    _print_or_write(schema_text(), out, overwrite=overwrite)


def _print_or_write(text: str, out: Path | None, *, overwrite: bool) -> None:
    """Print a text, or write it to a file in UTF-8."""
    from meshes.base.whole_file import require_new_file, write_text

    if out is None:
        left_out(
            "without --out, because the text is printed",
            "give --out, or remove this option",
            overwrite=overwrite,
        )
        sys.stdout.write(text)
        return
    require_new_file(out, overwrite=overwrite)
    write_text(out, text)
    console.print(f"wrote {out}")
