"""Folders of runs that `tissue view` opens, and windows driven as by a hand."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from fake_fields import block_series

from tissue import load_scene, simulate
from tissue.simulation.vtk_files import write_fields

FIXTURES = Path(__file__).parents[3] / "fixtures"


@pytest.fixture(scope="module")
def drive(display):
    """Drive a window by a script of the fixtures in a process of its own.

    Returns the last output of the script.
    """

    def run(script, *arguments):
        ended = subprocess.run(
            [sys.executable, str(FIXTURES / script), *map(str, arguments)],
            env={
                **os.environ,
                "DISPLAY": display,
                "PYTHONPATH": os.pathsep.join([str(FIXTURES.parents[1]), str(FIXTURES)]),
                "VTK_DEFAULT_OPENGL_WINDOW": "vtkXOpenGLRenderWindow",
            },
            capture_output=True,
            text=True,
            check=False,
            timeout=200,
        )
        if ended.returncode < 0 or "OpenGL" in ended.stderr:
            pytest.skip(f"no window can be opened here: {ended.stderr[-300:]}")
        assert ended.returncode == 0, ended.stderr
        return json.loads(ended.stdout.splitlines()[-1])

    return run


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """Folder of a quick run that ended."""
    scene = load_scene("milling", {"voxels.spacing_mm": 0.5, "duration_s": 0.2})
    return simulate(scene).save(tmp_path_factory.mktemp("runs") / "whole", pictures=False)


@pytest.fixture
def stopped(whole, tmp_path):
    """Return a copy of the run as a kill would have left it: 150 and a half rows, no bone."""
    folder = tmp_path / "stopped"
    folder.mkdir()
    shutil.copy(whole / "scene.toml", folder)
    summary = json.loads((whole / "summary.json").read_text())
    (folder / "summary.json").write_text(
        json.dumps(
            {"format": 1, "status": "running"}
            | {name: summary[name] for name in ("scene", "layers")}
        )
    )
    lines = (whole / "trace.csv").read_text().splitlines(keepends=True)
    (folder / "trace.csv").write_text("".join(lines[:151]) + lines[151][:40])
    return folder


@pytest.fixture(scope="session")
def layered(tmp_path_factory):
    """Folder of a quick run in bone of several layers, with fields."""
    scene = load_scene(
        "glenoid", {"voxels.spacing_mm": 0.5, "motion.feed_mm_s": 5.0, "duration_s": 0.5}
    )
    folder = simulate(scene).save(tmp_path_factory.mktemp("runs") / "layered", pictures=False)
    write_fields(block_series((-8e-3, -8e-3, -8e-3), (8e-3, 8e-3, 0.0), (8, 8, 6)), folder)
    return folder
