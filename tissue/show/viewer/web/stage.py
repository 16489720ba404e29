"""Off-screen view that a page shows as JPEG pictures and can rotate."""

from collections.abc import Callable
from io import BytesIO
from time import perf_counter

import numpy as np

from tissue.show.viewer.plotter import Plotter
from tissue.show.viewer.web.server import Values

MOST_PX = 1_000_000
"""Largest picture [pixels]; for larger pictures, OpenGL in software takes longer than a frame."""
QUALITY = 88
"""JPEG quality, 0 to 100; text and edges stay legible at this value."""
STILL_S = 0.25
"""Time without changes after which smooth edges are drawn [s].

With smooth edges, OpenGL in software takes four times as long.
"""
TURN_DEG = 180.0
"""Rotation of the view by a drag over the height of the picture [degrees]."""


class Stage:
    """Off-screen view that draws pictures for a page and can be rotated by the page.

    Parameters
    ----------
    plotter
        PyVista's plotter, off screen.
    aim
        Function that points the camera at the scene. It is called after each change of the picture
        size, until the user rotates the view.

    Attributes
    ----------
    changed
        True if the view has changed since the last drawing.
    """

    def __init__(self, plotter: Plotter, aim: Callable[[], None]) -> None:
        self._plotter = plotter
        self._aim = aim
        self._turned = False
        self._fine = False
        self._moved_s = 0.0
        self.changed = True
        plotter.show(auto_close=False, interactive=False)

    @property
    def tall_px(self) -> int:
        """Height of a picture [pixels]."""
        return int(self._plotter.window_size[1])

    def take(self, do: str, values: Values) -> bool:
        """Change size or view if a message requests this; return False for other messages."""
        changes: dict[str, Callable[..., None]] = {
            "size": self.resize,
            "turn": self.turn,
            "zoom": self.zoom,
        }
        change = changes.get(do)
        if change is not None:
            change(**{name: float(value) for name, value in values.items()})
        return change is not None

    def resize(self, wide: float, tall: float) -> None:
        """Set the size of pictures [pixels].

        A picture with more than `MOST_PX` pixels is reduced; its aspect ratio is kept.
        """
        scale = min(1.0, float(np.sqrt(MOST_PX / (wide * tall))))
        # even numbers, though odd ones are drawn as well
        size = [int(scale * wide) // 2 * 2, int(scale * tall) // 2 * 2]
        if size != list(self._plotter.window_size):
            self._plotter.window_size = size
            if not self._turned:
                self._aim()
            self.changed = True

    def turn(self, right: float, up: float) -> None:
        """Rotate the view by a drag of the mouse.

        `right` and `up` are the distances that the mouse was dragged, as fractions of the picture's
        height.
        """
        camera = self._plotter.camera
        camera.Azimuth(-TURN_DEG * right)
        camera.Elevation(-TURN_DEG * up)
        camera.OrthogonalizeViewUp()
        self._viewed()

    def zoom(self, by: float) -> None:
        """Zoom the view by a factor."""
        camera = self._plotter.camera
        # a parallel projection does not depend on the distance of the camera
        if camera.GetParallelProjection():
            camera.SetParallelScale(camera.GetParallelScale() / by)
        else:
            camera.Dolly(by)
        self._viewed()

    def picture(self) -> bytes | None:
        """Return the view as JPEG.

        After the view has stopped changing, one picture with smooth edges is returned. Later calls
        return None until the view changes again.
        """
        now = perf_counter()
        if self.changed:
            self.changed = False
            self._fine = False
            self._moved_s = now
            return self._drawn()
        if self._fine or now - self._moved_s < STILL_S:
            return None
        self._fine = True
        self._plotter.enable_anti_aliasing("ssaa")
        try:
            return self._drawn()
        finally:
            self._plotter.disable_anti_aliasing()

    def _drawn(self) -> bytes:
        from PIL import Image

        self._plotter.render()
        output = BytesIO()
        Image.fromarray(np.asarray(self._plotter.image)[..., :3]).save(
            output, "JPEG", quality=QUALITY, subsampling=0
        )
        return output.getvalue()

    def _viewed(self) -> None:
        self._plotter.renderer.ResetCameraClippingRange()
        self._turned = self.changed = True
