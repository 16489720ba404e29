"""Functions for all 3D views: text, colour scale, keys, clicks and camera."""

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array

Plotter: TypeAlias = Any
"""Type of a `pyvista.Plotter`.

The alias is `Any`, because PyVista does not declare the arguments of methods that it forwards to a
renderer.
"""
STILL_PX = 2
"""Largest motion of the mouse during a click [pixels], because hands are never still."""
KEPT_KEYS = tuple("eqrsw")
"""VTK keys that stay active: exit (e, q), camera reset (r), surfaces (s), wireframe (w)."""
ROTATE = 1
"""VTK's number of the interactor state in which the left button rotates the camera."""


def in_words(vector: ArrayLike, digits: int = 2) -> str:
    """Return the components of a vector as text, such as ``0.00, -1.25, 3.00``."""
    rounded = np.round(np.asarray(vector, dtype=np.float64), digits) + 0.0  # no -0.00
    return ", ".join(f"{one:.{digits}f}" for one in rounded)


def new_plotter(size_px: tuple[int, int], *, title: str = "", off_screen: bool) -> Plotter:
    """Return a plotter with a white background."""
    import pyvista

    plotter: Plotter = pyvista.Plotter(
        off_screen=off_screen, window_size=list(size_px), title=title
    )
    plotter.background_color = pyvista.Color("white")
    return plotter


def add_text(
    plotter: Plotter,
    words: str,
    place: tuple[float, float],
    *,
    size: int = 9,
    colour: object = "black",
    name: str | None = None,
) -> Any:
    """Write a text in the window, and return its actor.

    An actor with the same name is replaced. `place` is the lower left corner of the text, in
    fractions of the window.
    """
    actor = plotter.add_text(
        words, position=place, viewport=True, font_size=size, color=colour, name=name
    )
    # keeps the text readable in front of a large tool
    actor.prop.background_color = "white"
    actor.prop.background_opacity = 0.7
    return actor


def add_names(plotter: Plotter, colours: Mapping[str, tuple[float, float, float]]) -> None:
    """Write each key of `colours` in its colour, in columns at the upper right."""
    for place, (name, colour) in enumerate(colours.items()):
        # a fourth line would lie on the title of the colour scale
        column, row = divmod(place, 3)
        at = (0.87 - 0.14 * column, 0.93 - 0.035 * row)
        add_text(plotter, name, at, size=11, colour=colour)


def add_slider(
    plotter: Plotter,
    call: Callable[[float], None],
    span: tuple[float, float],
    value: float,
    *,
    place: tuple[float, float, float],
    fmt: str,
) -> Any:
    """Add a horizontal slider that calls a function with its value.

    `place` contains the left end, right end and vertical position, as fractions of the window size.
    """
    left, right, height = place
    return plotter.add_slider_widget(
        call,
        span,
        value=value,
        fmt=fmt,
        pointa=(left, height),
        pointb=(right, height),
        color="black",
        # shares of the window: letters as high as those of the help, and a handle that
        # is wider than its line
        title_height=0.024,
        slider_width=0.012,
        tube_width=0.003,
        interaction_event="always",
    )


def picked(plotter: Plotter, actor: object, x: int, y: int) -> Array | None:
    """Return the point [mm] of an actor under a pixel; None if the actor is not under the pixel.

    `x` and `y` are counted in pixels from the lower left corner of the window.
    """
    from vtkmodules.vtkRenderingCore import vtkCellPicker

    picker: Any = vtkCellPicker()
    # in shares of the window's diagonal: a fraction of a pixel
    picker.SetTolerance(1e-4)
    picker.InitializePickList()
    if actor is not None:
        picker.AddPickList(actor)
    picker.PickFromListOn()
    if not picker.Pick(float(x), float(y), 0.0, plotter.renderer) or picker.GetCellId() < 0:
        return None
    return np.array(picker.GetPickPosition())


def add_colour_scale(
    plotter: Plotter, title: str, mapper: object, *, bottom: float, **options: object
) -> None:
    """Draw the colour scale of a VTK mapper at the right.

    `bottom` is the lower end of the scale, relative to the height of the window.
    """
    plotter.add_scalar_bar(
        title,
        mapper=mapper,
        vertical=True,
        # to the right of the scene, which ends at 0.86, see `MARGINS`
        position_x=0.87,
        # it ends below the title of the window
        position_y=bottom,
        height=0.42,
        width=0.07,
        color="black",
        title_font_size=24,
        label_font_size=24,
        render=False,
        **options,
    )


def on_click(plotter: Plotter, click: Callable[[int, int], object]) -> None:
    """Call a function with the mouse position whenever the left button is clicked.

    The position is x and y in pixels from the lower left corner. In a click, the button is pressed
    and released in the same place. Between press and release, VTK's interactor style, which rotates
    the camera, receives all mouse events. The function therefore listens to the events of the
    interactor style.
    """
    interactor = plotter.iren.interactor
    style = interactor.GetInteractorStyle()
    pressed: list[tuple[int, int]] = []

    def down(*_: object) -> None:
        pressed[:] = [interactor.GetEventPosition()] if style.GetState() == ROTATE else []

    def up(*_: object) -> None:
        place = interactor.GetEventPosition()
        if pressed and np.abs(np.subtract(place, pressed.pop())).max() <= STILL_PX:
            click(*place)
            plotter.render()

    style.AddObserver("StartInteractionEvent", down)
    style.AddObserver("EndInteractionEvent", up)


def free_keys(plotter: Plotter) -> None:
    """Switch off the keys that VTK binds to actions, except `KEPT_KEYS`.

    For example, VTK binds the key 3 to a stereo picture, and the key m to an animation that blocks
    the mouse.
    """
    interactor = plotter.iren.interactor
    style = interactor.GetInteractorStyle()
    style.AddObserver(
        "CharEvent", lambda *_: style.OnChar() if interactor.GetKeyCode() in KEPT_KEYS else None
    )


EYE = (0.25, -0.75, 0.8)
UP = (0.0, 0.35, 1.0)
MARGINS = (0.2, 0.86, 0.36, 0.88)
"""Left, right, lower and upper end of the area for the scene, in shares of the window."""


def aim(
    plotter: Plotter,
    points_mm: Array,
    *,
    margins: tuple[float, float, float, float] = MARGINS,
    parallel: bool = False,
) -> None:
    """Aim the camera from the front and above, so that the given points fill an area of the window.

    `margins` are the left, right, lower and upper end of the area, relative to the window.

    If no points are given, everything drawn is in view, centred vertically in the area.

    A scale bar needs a parallel projection, because only this projection has the same scale
    everywhere.
    """
    import pyvista

    plotter.camera.parallel_projection = parallel
    plotter.camera.SetWindowCenter(0.0, 0.0)
    plotter.camera_position = [EYE, (0.0, 0.0, 0.0), UP]
    plotter.reset_camera()
    left, right, low, high = margins
    if not len(points_mm):
        # everything is in view already: it is only moved to the middle height of the area
        plotter.camera.SetWindowCenter(0.0, 1.0 - (low + high))
        return
    wide, tall = plotter.window_size
    matrix = plotter.camera.GetCompositeProjectionTransformMatrix(wide / tall, -1.0, 1.0)
    view = pyvista.array_from_vtkmatrix(matrix)
    seen = np.column_stack([points_mm, np.ones(len(points_mm))]) @ view.T
    seen = seen[:, :2] / seen[:, 3:]  # -1 to 1 across the window
    first = seen.min(axis=0)
    last = seen.max(axis=0)
    share = 2.0 * np.array([right - left, high - low])
    # a single point has no extent
    zoom = float((share / np.maximum(last - first, 1e-9)).min())
    plotter.camera.zoom(zoom)
    middle = np.array([left + right, low + high]) - 1.0
    plotter.camera.SetWindowCenter(*(0.5 * zoom * (first + last) - middle))
