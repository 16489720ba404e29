"""Layers in the window of `tissue view`: the digits switch them on and off, on the bone and on the fields alike."""

from collections.abc import Callable, Sequence

from tissue.viewer.plotter import Plotter

__all__ = ["LayerKeys"]

MOST = 9
"""Layers that have a key."""


class LayerKeys:
    """Layers that are on or off.

    Parameters
    ----------
    plotter
        Where the digits are bound.
    names
        Layers; the first has the key 1.
    hidden
        Layers that are off at first.
    targets
        Each is called with the layers that are off, now and whenever they change.

    Attributes
    ----------
    hidden
        Layers that are off.
    help
        The keys, in words; empty where there is but one layer.
    """

    def __init__(
        self,
        plotter: Plotter,
        names: Sequence[str],
        *,
        hidden: Sequence[str] = (),
        targets: Sequence[Callable[[frozenset[str]], None]],
    ) -> None:
        self._plotter, self._targets = plotter, tuple(targets)
        self.hidden: frozenset[str] = frozenset()
        keys = dict(enumerate(names[:MOST], 1)) if len(names) > 1 else {}
        listed = "  ".join(f"{number}: {name}" for number, name in keys.items())
        self.help = f"{listed} on or off" if keys else ""
        for number, name in keys.items():
            plotter.add_key_event(str(number), lambda name=name: self.toggle(name))
        if hidden:
            self.toggle(*hidden)

    def toggle(self, *names: str) -> None:
        """Switch layers on or off."""
        self.hidden ^= frozenset(names)
        for report in self._targets:
            report(self.hidden)
        self._plotter.render()
