"""``tissue schema``."""

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tissue.cli.terminal import console, left_out

__all__ = ["schema"]


def schema(
    *, out: Path | None = None, overwrite: Annotated[bool, Parameter(negative="")] = False
) -> None:
    """Print the JSON schema of scenes, which editors use to complete and check keys.

    Parameters
    ----------
    out
        File to write instead of printing.
    overwrite
        Replace an existing file.
    """
    from meshes.base.errors import InputError
    from meshes.base.whole_file import whole_file
    from tissue.scene.schema import schema_text
    from tissue.system.outputs import require_new_file

    if out is None:
        left_out("where the schema is printed", "give --out or leave it out", overwrite=overwrite)
        sys.stdout.write(schema_text())
        return
    require_new_file(out, overwrite=overwrite)
    if not out.parent.is_dir():
        raise InputError("out", "lie in a folder that exists", out, f"create {out.parent}")
    with whole_file(out) as temporary:
        temporary.write_text(schema_text(), "utf-8")
    console.print(f"wrote {out}")
