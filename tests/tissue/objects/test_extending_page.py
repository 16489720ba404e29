"""The Python of the page on parts of one's own runs, from its first block to its last."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tissue.scene.plugins import OFFERED
from tissue.scene.registry import TABLES

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs" / "extending.md").read_text("utf-8")


@pytest.mark.slow
def test_the_blocks_of_the_page_run_in_turn(tmp_path):
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    assert len(blocks) == 7
    ended = subprocess.run(
        [sys.executable, "-c", "\n".join(blocks)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert ended.returncode == 0, ended.stderr
    expected, device, removed, names, energy, anatomy, scene, stopped = ended.stdout.splitlines()
    assert "RMS error" in expected and "my-pen is read and played by MyPen [0. 0. 0.]" in device
    assert 0.0 < float(removed) < 10.0 and names == "('foam',)" and energy.startswith("foam 0.015")
    assert "stiffness_N_m=50.0" in anatomy and scene == "soft-wall"
    end_s, force_N = map(float, stopped.split())
    assert 0.2 < end_s < 0.9 and force_N >= 0.5


def test_the_page_names_every_kind_and_group():
    rows = re.findall(r"^\| [^|]+ \| `register\.(\w+)` \| `(\w+)` \|", PAGE, re.MULTILINE)
    assert dict(rows) == {kind: group.removeprefix("tissue.") for group, kind in OFFERED.items()}
    assert set(dict(rows)) == set(TABLES)
