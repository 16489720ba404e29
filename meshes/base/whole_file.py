"""Files that are there whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from uuid import uuid4

__all__ = ["whole_file"]


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A temporary name in a file's folder, of the same ending, to write to in the block.

    What was written takes the file's place in one step when the block ends, and goes when it fails; so no reader sees
    half of it, and of two writers one wins.
    """
    temporary = path.with_name(f".{uuid4().hex[:12]}-{path.name}")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        if error.filename == str(temporary):
            error.filename = str(path)  # the name that is known to who asked for it
        raise
    finally:
        with suppress(OSError):
            temporary.unlink()
