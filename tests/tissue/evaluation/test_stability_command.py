"""`tissue stability`: the verdict on a scene's loop, its map as picture and data."""

import numpy as np
import pytest


@pytest.mark.slow
def test_a_map_is_printed_and_kept(command, here):
    code, out, error = command("stability", "wall", "--out", "map")
    assert (code, error) == (0, "")
    assert "delay 0.5 ms (coupling.delay_ms = 0, and 0.5 ms for device and tissue model)" in out
    assert "chosen: stiffness 400 N/m is stable" in out and "delay  0.0 ms: stable below" in out
    assert (here / "map" / "stability.png").stat().st_size > 10_000
    rows = np.genfromtxt(here / "map" / "stability_delay.csv", delimiter=",", names=True)
    assert rows["delay_s"][0] == 0.0 and len(rows) > 10
    np.testing.assert_allclose(rows["measured_N_m"], rows["exact_N_m"], rtol=0.01)
    assert (rows["passive_N_m"] < rows["exact_N_m"]).all()
    code, _, error = command("stability", "wall", "--out", "map")
    assert code == 2 and "out must not contain another map" in error
