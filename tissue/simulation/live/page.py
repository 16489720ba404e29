"""A page for a browser in place of a live run's window, which lasts over several runs of its scene."""

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from tissue.builders.parts import Parts
from tissue.scene.scene import Scene
from tissue.simulation.live.window import WindowProcess
from tissue.system.offscreen import REMEDY, drawing_environments

__all__ = ["Page", "PageProcess", "require_web"]


class PageProcess(WindowProcess):
    """A window in a browser: its process draws off screen and serves a page."""

    module = "tissue.viewer.web.live_page"
    place = "must serve its page"
    remedy = REMEDY


class Page:
    """The page of a live run; its process starts with the first run that is shown.

    Parameters
    ----------
    opened
        Called once with the page's address, which holds a random token.
    """

    def __init__(self, opened: Callable[[str], object]) -> None:
        self._opened = opened
        self._process: PageProcess | None = None

    def show(
        self,
        scene: Scene,
        parts: Parts,
        columns: tuple[str, ...],
        *,
        low_m: NDArray[np.float64],
        high_m: NDArray[np.float64],
    ) -> PageProcess:
        """Show a run from its start; arguments as of `WindowProcess`.

        Raises
        ------
        InputError
            If nothing can be drawn or served here.
        """
        if self._process is not None:
            self._process.begin_again(parts)
            return self._process
        failed: InputError | None = None
        for environment in drawing_environments():
            try:
                self._process = PageProcess(scene, parts, columns, low_m=low_m, high_m=high_m, environment=environment)
            except InputError as error:
                failed = error
                continue
            self._opened(self._process.address)
            return self._process
        raise failed or InputError(f"--live must serve its page, but this machine has no OpenGL library: {REMEDY}")

    def close(self) -> None:
        """End it."""
        if self._process is not None:
            self._process.end()
            self._process = None


def require_web() -> None:
    """Refuse a page where the server for it is not installed.

    Raises
    ------
    InputError
        If aiohttp is missing.
    """
    if find_spec("aiohttp") is None:
        raise InputError("--web must have aiohttp to serve its page, got none: pip install 'tissue-sim[web]'")
