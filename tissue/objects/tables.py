"""Tables of texts and numbers as CSV."""

import csv
from collections.abc import Iterable, Sequence
from io import StringIO
from pathlib import Path

from meshes.base.whole_file import whole_file

__all__ = ["write_table"]


def write_table(path: Path, titles: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write rows with all digits; None becomes an empty cell."""
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(titles)
    writer.writerows(["" if each is None else each for each in row] for row in rows)
    with whole_file(path) as temporary:
        temporary.write_text(text.getvalue(), "utf-8")
