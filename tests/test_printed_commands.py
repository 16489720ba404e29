"""Commands that the pages print for measuring or checking runs.

Benches run in their quickest form, tests are found by name.

Calls of ``tissue`` that pages print are read in `tests/test_docs.py`, and run over all scenes in
`tests/faults/test_every_scene_every_command.py`.
"""

import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted(
    [
        *ROOT.glob("docs/**/*.md"),
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        ROOT / "tests/bench/README.md",
    ]
)
SCRIPT = re.compile(r"python ((?:tests/bench|examples)/[\w/]+\.py)")
TEST = re.compile(r"pytest ([^`#\n]+)")
START_S = 3.0
"""Time for which a bench without a quick form is observed [s].

In this time it imports, builds its first case and computes.
"""
FINISH_S = 240.0
"""Longest time of a bench in its quick form [s] on a loaded machine."""

FINISHED: dict[str, str] = {
    "bench_null": "--quick",
    "import_graph": "{out}/imports.png",
}
"""Benches that must end within `FINISH_S`, with their arguments."""
STARTED: dict[str, str] = {
    "bench_assessment": "wall --people 1 --out {out}",
    "bench_band": "",
    "bench_band_integrals": "",
    "bench_adaptation": "wall --hands 1",
    "bench_bone": "--quick",
    "bench_calibration": "coverage",
    "bench_closed_loop": "wall --hands 1",
    "bench_fit_cutting": "bone --fits 2 --processes 1",
    "bench_fit_organ": "elastic --fits 1 --processes 1",
    "bench_force_law": "--quick",
    "bench_force_scale": "T2 --people 1 --scale 0.02",
    "bench_held_steps": "milling --hands 1 --seconds 0.5",
    "bench_held_tool": "milling --hands 1 --seconds 0.5",
    "bench_index": "milling voxels.spacing_mm=0.8 duration_s=0.05",
    "bench_jitter": "--minutes 0.02",
    "bench_law": "milling --rounds 1",
    "bench_law_region": "--seconds 0.4 --regions 1.5",
    "bench_random_presses": "--presses 2",
    "bench_nodule": "--quick",
    "bench_perception": "--quick",
    "bench_prediction": "wall --hands 2 --moved 0 --out {out}",
    "bench_probes": "--splits 2 --laws linear",
    "bench_reference": "milling voxels.spacing_mm=0.8 duration_s=0.05",
    "bench_session": "--part server",
    "bench_study": "--trials 1 --tasks T2",
    "bench_tooth": "--quick",
    "bench_velocity": "wall",
    "chart_liver": "--quick",
    "chart_wall": "--quick --out {out}",
    "golden": "{out}/golden.json --record --only wall",
    "held_out": "--out {out}",
    "mutants": "--count 1",
    "profile_ticks": "--added wall",
    "public_surface": "",
    "structure": "",
}
"""Benches that are watched for `START_S`, with their arguments: they may end, and must not fail."""


def printed(pattern):
    """Each match of a pattern in the pages."""
    return sorted(
        {found[1] for page in PAGES for found in pattern.finditer(page.read_text("utf-8"))}
    )


def name_of(script):
    """Name of a bench in the tables."""
    return script.removeprefix("tests/bench/").removesuffix(".py")


BENCHES = sorted(
    {name_of(script) for script in printed(SCRIPT) if script.startswith("tests/bench")}
)


def test_every_printed_script_is_there_and_every_bench_has_a_quick_form():
    missing = [script for script in printed(SCRIPT) if not (ROOT / script).is_file()]
    assert not missing
    assert set(BENCHES) <= set(FINISHED) | set(STARTED)


@pytest.mark.slow
@pytest.mark.parametrize("bench", BENCHES)
def test_a_printed_bench_runs(bench, tmp_path):
    words = (FINISHED | STARTED)[bench].format(out=tmp_path).split()
    command = [sys.executable, str(ROOT / "tests" / "bench" / f"{bench}.py"), *words]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    }
    with (tmp_path / "printed.txt").open("w+") as log:
        process = subprocess.Popen(
            command,
            cwd=tmp_path,
            env=environment,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            code = process.wait(FINISH_S if bench in FINISHED else START_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            code = None if bench in STARTED else "not finished"
        log.seek(0)
        text = log.read()
    assert code in (0, None) and "Traceback" not in text, (
        f"{shlex.join(command)} ended with {code}\n{text[-3000:]}"
    )


def test_printed_tests_exist():
    """Paths that pages print behind ``pytest``."""
    paths = [word for words in printed(TEST) for word in words.split() if word.startswith("tests/")]
    missing = [path for path in paths if not (ROOT / path.split("::")[0].rstrip(".,;)")).exists()]
    assert paths and not missing


@pytest.mark.slow
def test_printed_selections_select_something():
    """Words that pages print behind ``-k``."""
    for words in printed(TEST):
        if " -k " not in f" {words}":
            continue
        asked = [
            word
            for word in shlex.split(words.split(" with ")[0])
            if word not in ("-s", "-rP", "-n", "0")
        ]
        command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-m", "slow or not slow"]
        kept = [
            word
            for index, word in enumerate(asked)
            if word != "-m" and (index == 0 or asked[index - 1] != "-m")
        ]
        ended = subprocess.run(
            [*command, *kept], cwd=ROOT, capture_output=True, text=True, timeout=300, check=False
        )
        assert ended.returncode == 0, f"pytest {words}\n{ended.stdout[-1500:]}"
