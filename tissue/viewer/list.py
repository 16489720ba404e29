"""A list of fields in the window of `tissue view`: a click on a name shows it."""

from collections.abc import Callable, Sequence

from tissue.viewer.plotter import Plotter

__all__ = ["NameList"]

LEFT, TOP, ROW, WIDTH, LETTER = 0.012, 0.80, 0.032, 0.2, 0.024
"""Place and size of the list in shares of the window: a row lies upon the line of its letters."""
CHOSEN, OTHER = "#0072B2", (0.45, 0.45, 0.45)


class NameList:
    """Names below each other, of which one is chosen.

    Parameters
    ----------
    plotter
        The window.
    title
        Title above them.
    names
        What can be chosen, and the words that it is shown by.
    choose
        Called with what a click chose.
    """

    def __init__(
        self,
        plotter: Plotter,
        title: str,
        names: Sequence[tuple[str | None, str]],
        *,
        choose: Callable[[str | None], None],
    ) -> None:
        self._plotter, self._names, self._choose = plotter, list(names), choose
        self._words = [
            plotter.add_text(words, position=(LEFT, TOP - ROW * row), viewport=True, font_size=10, color="black")
            for row, words in enumerate([title, *(words for _, words in self._names)])
        ][1:]

    def mark(self, name: str | None) -> None:
        """Show which one is chosen."""
        from pyvista import Color

        for (each, words), actor in zip(self._names, self._words, strict=True):
            chosen = each == name
            actor.input = f"{'>' if chosen else '  '} {words}"
            actor.prop.color = Color(CHOSEN if chosen else OTHER)

    def click(self, x: int, y: int) -> bool:
        """Choose the name under a pixel, counted from the lower left; whether there was one."""
        wide, tall = self._plotter.window_size
        row = int((TOP + LETTER - y / tall) // ROW) - 1
        if not (LEFT <= x / wide <= LEFT + WIDTH and 0 <= row < len(self._names)):
            return False
        self._choose(self._names[row][0])
        return True
