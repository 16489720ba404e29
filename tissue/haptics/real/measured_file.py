"""File of constants from a self-test, for a scene's key ``materials``."""

from datetime import date
from pathlib import Path

from meshes.base.whole_file import whole_file
from tissue.haptics.real.self_test import SelfTest
from tissue.models.tissue_model import TICK_S

__all__ = ["write_measured"]

EVERY_TICK = 0.95
"""Share of ticks with a new sample above which the device counts as running at our rate."""
SLOWEST_HZ, LONGEST_S = 10.0, 0.2
"""Smallest rate and longest delay that `tissue.haptics.device.device.DeviceParameters` accepts."""


def write_measured(path: Path, name: str, test: SelfTest) -> None:
    """Write the rate and latency of a device as constants with their ranges.

    The rate is the mean rate. It is the tick rate if nearly every tick has a sample. The low end of
    its range is the rate that 99 % of the intervals reach. The latency is the round trip, or the
    duration of the calls if the device does not report one.
    """
    most = 1.0 / TICK_S
    rate, low = (
        min(max(each, SLOWEST_HZ), most) for each in (test.rate_Hz, 1.0 / test.interval_99_s)
    )
    rate = most if rate >= EVERY_TICK * most else rate
    delay = min(test.delay_s, LONGEST_S)
    high = min(max(test.delay_99_s, test.delay_s), LONGEST_S)
    by = (
        f"measured by tissue devices --test {name} for {test.seconds:g} s on "
        f"{date.today().isoformat()}"
    )
    entries = (
        ("rate_Hz", rate, min(low, rate), rate, f"{test.samples} samples"),
        ("transport_delay_s", delay, 0.0, high, "median and 99 %"),
    )
    text = "".join(
        f"[devices.{name}.{key}]\nvalue = {value:.6g}\nrange = [{least:.6g}, {largest:.6g}]\n"
        f'source = "{by}, {what}"\nconfidence = "M"\n\n'
        for key, value, least, largest, what in entries
    )
    with whole_file(path) as temporary:
        temporary.write_text(
            '# Constants of a device: use them in a scene by  materials = "FILE"\n'
            + text.rstrip()
            + "\n",
            "utf-8",
        )
