"""Time in the window of `tissue view`: a slider, and playing by a key or a button as fast as it really was."""

from collections.abc import Callable
from time import perf_counter

from tissue.viewer.plotter import Plotter

__all__ = ["Playback"]

EVERY_MS = 40
KEY = "space"


class Playback:
    """The moment that is shown, moved by hand or by itself.

    Parameters
    ----------
    plotter
        The window.
    show
        Called with the moment [s].
    span_s
        First and last moment [s].
    begin_s
        Moment that is shown at first [s].
    slider
        Ends of the slider in shares of the window, left, right and height.
    slowest_s
        What takes less time than this is played slower, so that it lasts this long [s].

    Attributes
    ----------
    span_s
        First and last moment [s].
    time_s
        The moment [s].
    playing
        Whether it moves by itself.
    """

    def __init__(
        self,
        plotter: Plotter,
        show: Callable[[float], None],
        *,
        span_s: tuple[float, float],
        begin_s: float,
        slider: tuple[float, float, float],
        slowest_s: float = 4.0,
    ) -> None:
        self._plotter, self._show, self.span_s = plotter, show, span_s
        self._rate = min((span_s[1] - span_s[0]) / slowest_s, 1.0)
        self.time_s, self.playing, self._shown_s = begin_s, False, 0.0
        self._mark_button: Callable[[int], None] = lambda playing: None
        left, right, height = slider
        self._slider = plotter.add_slider_widget(
            self._drag,
            span_s,
            value=begin_s,
            fmt="%.3f s",
            pointa=(left, height),
            pointb=(right, height),
            color="black",
            title_height=0.024,
            slider_width=0.012,
            tube_width=0.003,
            interaction_event="always",
        )

    def start(self) -> None:
        """Bind the key, add the button and start the clock of a window that is about to open."""
        plotter = self._plotter
        button = plotter.add_checkbox_button_widget(
            self._press, position=(14.0, 282.0), size=28, border_size=3, color_on="#0072B2", color_off="#BBBBBB"
        )
        self._mark_button = button.GetRepresentation().SetState
        plotter.add_text("play", position=(0.035, 0.298), viewport=True, font_size=9, color="black")
        plotter.add_key_event(KEY, self.switch)
        plotter.iren.add_observer("TimerEvent", lambda *_: self.tick(perf_counter()))
        plotter.iren.initialize()
        plotter.iren.interactor.CreateRepeatingTimer(EVERY_MS)

    def switch(self) -> None:
        """Play or pause; at the end it begins again."""
        self.playing = not self.playing
        if self.playing:
            self._shown_s = perf_counter()
            if self.time_s >= self.span_s[1]:
                self.to(self.span_s[0])
        self._mark_button(int(self.playing))
        self._plotter.render()

    def tick(self, now_s: float) -> None:
        """Move on by the time that has passed since the last tick, if it plays."""
        if not self.playing:
            return
        passed, self._shown_s = now_s - self._shown_s, now_s
        self.to(min(self.time_s + self._rate * passed, self.span_s[1]))
        if self.time_s >= self.span_s[1]:
            self.switch()

    def to(self, time_s: float) -> None:
        """Go to a moment."""
        self.time_s = time_s
        self._slider.GetRepresentation().SetValue(time_s)
        self._show(time_s)
        self._plotter.render()

    def _drag(self, time_s: float) -> None:
        self.time_s = time_s
        self._show(time_s)

    def _press(self, pressed: bool) -> None:
        if bool(pressed) != self.playing:
            self.switch()
