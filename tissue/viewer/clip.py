"""The clip plane in the window of `tissue view`: switched and pushed by keys, turned and pushed by the mouse."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tissue.viewer.fields import FieldsShown, Plane
from tissue.viewer.plotter import Plotter

if TYPE_CHECKING:
    from vtkmodules.vtkInteractionWidgets import vtkImplicitPlaneWidget

__all__ = ["HELP", "ClipPlane"]

KEY, OUT, IN = "x", "comma", "period"
HELP = "x: clip plane    , .: push it    drag its arrow: turn it"
STEP = 0.02
"""How far a key pushes the plane, in diagonals of the mesh."""


class ClipPlane:
    """A plane that cuts the fields open.

    Parameters
    ----------
    plotter
        The window.
    fields
        What is cut.
    start
        Where the plane lies when it is first switched on.
    """

    def __init__(self, plotter: Plotter, fields: FieldsShown, *, start: Plane) -> None:
        self._plotter, self._fields = plotter, fields
        self._plane = fields.clip or start
        self._widget: vtkImplicitPlaneWidget | None = None
        self._on = fields.clip is not None
        plotter.add_key_event(KEY, self.switch)
        plotter.add_key_event(OUT, lambda: self.push(STEP))
        plotter.add_key_event(IN, lambda: self.push(-STEP))
        fields.drawn.append(self._follow)
        self._follow()

    def switch(self) -> None:
        """Cut the mesh open, or close it again."""
        self._on = not self._on
        self._fields.cut(self._plane if self._on else None)
        self._plotter.render()

    def move(self, normal: Sequence[float], origin: Sequence[float]) -> None:
        """Bring the plane elsewhere."""
        (a, b, c), (x, y, z) = np.array((normal, origin)).tolist()
        self._plane = (a, b, c), (x, y, z)
        if self._on:
            self._fields.cut(self._plane)

    def push(self, share: float) -> None:
        """Move the plane along its normal, by a share of the mesh's diagonal."""
        normal, origin = self._plane
        size = np.linalg.norm(np.diff(np.reshape(self._fields.bounds_mm, (3, 2)), axis=1))
        moved = np.add(origin, share * size * np.array(normal)).tolist()
        if self._widget is not None:
            self._widget.SetOrigin(*moved)
        self.move(normal, moved)
        self._plotter.render()

    def _follow(self) -> None:
        """Show the handles of the plane while there is something that it cuts."""
        wanted = self._on and self._fields.name is not None
        if wanted and self._widget is None and self._fields.actor is not None:
            normal, origin = self._plane
            self._widget = self._plotter.add_plane_widget(
                self.move,
                normal=normal,
                origin=origin,
                bounds=self._fields.bounds_mm,
                factor=1.1,
                color="#CC79A7",
                outline_opacity=0.15,
                test_callback=False,
                interaction_event="always",
            )
        elif self._widget is not None and bool(self._widget.GetEnabled()) != wanted:
            self._widget.SetEnabled(wanted)
