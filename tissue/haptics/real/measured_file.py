"""What a self-test measured, as a file of constants that a scene's key ``materials`` takes."""

from datetime import date
from pathlib import Path

from meshes.base.whole_file import whole_file
from tissue.haptics.real.self_test import SelfTest
from tissue.models.tissue_model import TICK_S

__all__ = ["write_measured"]

EVERY_TICK = 0.95
"""Share of the ticks with a new sample from which on the device counts as one of our rate."""
SLOWEST_HZ, LONGEST_S = 10.0, 0.2
"""What `tissue.haptics.device.device.DeviceParameters` takes at least and at most."""


def write_measured(path: Path, name: str, test: SelfTest) -> None:
    """Write rate and latency of a device as constants of it, with their ranges.

    The rate is the mean one, and that of our ticks where nearly every tick has a sample; the low
    end of its range is what 99 % of the intervals keep. The latency is the round trip, or what the
    calls take where the device shows none.
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
