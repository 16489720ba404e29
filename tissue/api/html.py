"""Small pieces of HTML for notebooks: everything that is shown is escaped here."""

from collections.abc import Iterable, Sequence
from html import escape

__all__ = ["curve", "folded", "scrolled", "table_html"]


def table_html(
    rows: Iterable[Sequence[object]], *, titles: Sequence[str] = (), caption: str = "", numbers: bool = False
) -> str:
    """A table of texts; ``numbers`` puts them to the right, as columns of numbers stand."""
    side = "right" if numbers else "left"
    head = f"<caption>{escape(caption)}</caption>" if caption else ""
    if titles:
        head += f"<thead><tr>{_cells(titles, 'th', side)}</tr></thead>"
    body = "".join(f"<tr>{_cells(row, 'td', side)}</tr>" for row in rows)
    return f"<table>{head}<tbody>{body}</tbody></table>"


def curve(values: Sequence[float], *, title: str, width: int = 320, height: int = 48) -> str:
    """A small curve from zero, without axes."""
    top = max(*values, 0.0) or 1.0
    step = width / max(len(values) - 1, 1)
    points = " ".join(f"{step * i:.1f},{height - 1 - (height - 2) * value / top:.1f}" for i, value in enumerate(values))
    line = f'<polyline points="{points}" fill="none" stroke="currentColor" stroke-width="1.2"/>'
    return f'<svg width="{width}" height="{height}" role="img"><title>{escape(title)}</title>{line}</svg>'


def folded(title: str, inner: str, *, is_open: bool = False) -> str:
    """HTML under a title that opens and closes it."""
    return f"<details{' open' if is_open else ''}><summary>{escape(title)}</summary>{inner}</details>"


def scrolled(inner: str) -> str:
    """HTML that is scrolled sideways where it is wider than the page."""
    return f'<div style="overflow-x: auto">{inner}</div>'


def _cells(row: Sequence[object], name: str, side: str) -> str:
    style = f' style="text-align: {side}; white-space: nowrap"' if side == "right" else ' style="text-align: left"'
    return "".join(f"<{name}{style}>{escape(str(each))}</{name}>" for each in row)
