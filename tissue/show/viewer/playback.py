"""Time that a view of a run shows."""

from time import perf_counter

SLOWEST_S = 4.0
"""Shortest duration of a playback [s]; a shorter run is played slower."""


class Playback:
    """Time that a view shows, set by the user or advanced by the playback.

    Parameters
    ----------
    span_s
        First and last time [s].
    time_s
        Time that is shown at the start [s].

    Attributes
    ----------
    time_s
        Shown time [s].
    playing
        True if the playback changes the time.
    """

    def __init__(self, span_s: tuple[float, float], time_s: float) -> None:
        self.span_s = span_s
        self.time_s = time_s
        self.playing = False
        self._rate = min((span_s[1] - span_s[0]) / SLOWEST_S, 1.0)
        self._before_s = 0.0

    def play(self, playing: bool) -> None:
        """Start or pause the playback; if the last time is shown, start from the first time."""
        self.playing = playing
        self._before_s = perf_counter()
        if playing and self.time_s >= self.span_s[1]:
            self.time_s = self.span_s[0]

    def advance(self) -> bool:
        """Advance the shown time by the elapsed time; return False while the playback is paused."""
        if not self.playing:
            return False
        now_s = perf_counter()
        passed_s = self._rate * (now_s - self._before_s)
        self._before_s = now_s
        self.time_s = min(self.time_s + passed_s, self.span_s[1])
        self.playing = self.time_s < self.span_s[1]
        return True
