"""Detection of samples whose noise exceeds any motion of a handheld device."""

__all__ = ["Roughness"]

MEMORY = 8.0
"""Number of new samples over which roughness is averaged."""
STALE = 0.25
"""Weight of a sample that only repeats the last one."""
ROUGH, SMOOTH = 0.5, 0.05
"""Share of rough samples above which a signal is noise, and below which it is valid again."""
SHORTEST_S = 2e-3
"""Shortest span of three samples [s]: encoder steps and clock jitter disturb shorter ones."""

Place = tuple[float, float, float, float, float]
"""Time [s] and up to four coordinates."""


class Roughness:
    """Detector of noise in a sequence of samples, from the implied acceleration.

    The middle one of three samples deviates from the straight line between its neighbours. For
    steps of T at the acceleration a, the deviation is at most a T^2 / 2. A sample is rough if it
    deviates more than the limit allows. The signal becomes noise when more than half of its last
    samples (exponential mean over 8 samples) are rough. It is valid again when fewer than a
    twentieth are rough. One jump, a lost sample, an encoder step or a blow is rough for two samples
    at most. White noise is detected from a standard deviation of about a quarter of the limit times
    (1 ms)^2 per axis.

    Parameters
    ----------
    limit
        Largest acceleration, in the unit of the samples over s^2.

    Attributes
    ----------
    noisy
        True if the signal is noise.
    share
        Share of rough samples among the last ones.
    """

    def __init__(self, limit: float) -> None:
        self._limit = limit / 8.0
        self.noisy = False
        self.share = 0.0
        self._first: Place | None = None
        self._middle: Place | None = None

    def observe(self, time_s: float, x: float, y: float, z: float, w: float = 0.0) -> bool:
        """Process a sample with its time [s], and return whether the signal is noise."""
        first = self._first
        middle = self._middle
        if (
            middle is not None
            and x == middle[1]
            and y == middle[2]
            and z == middle[3]
            and w == middle[4]
        ):
            if self.share > 0.0:
                self._count(False, STALE / MEMORY)
            return self.noisy
        self._first = middle
        self._middle = (time_s, x, y, z, w)
        if first is None or middle is None:
            return False
        start, ax, ay, az, aw = first
        between, bx, by, bz, bw = middle
        span = time_s - start
        part = (between - start) / span if span > 0.0 else 0.5
        dx = bx - ax - part * (x - ax)
        dy = by - ay - part * (y - ay)
        dz = bz - az - part * (z - az)
        dw = bw - aw - part * (w - aw)
        square = dx * dx + dy * dy + dz * dz + dw * dw
        span = span if span > SHORTEST_S else SHORTEST_S
        allowed = self._limit * span * span
        rough = square > allowed * allowed
        if rough or self.share > 0.0:
            self._count(rough, 1.0 / MEMORY)
        return self.noisy

    def _count(self, rough: bool, weight: float) -> None:
        self.share += weight * (rough - self.share)
        if self.share > ROUGH:
            self.noisy = True
        elif self.share < SMOOTH:
            self.noisy = False
            if self.share < 1e-6:
                self.share = 0.0
