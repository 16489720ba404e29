"""Short runs and their reports, made once for each worker."""

import pytest

from tissue.objects.run import report
from tissue.objects.simulate import simulate
from tissue.scene.load import load_scene

SHORT = {
    "milling": {"voxels.spacing_mm": 0.5, "duration_s": 0.3},
    "palpation": {"duration_s": 0.6, "organ.order": 1},
    "needle": {"duration_s": 1.2, "anatomy.interval_ms": 300},
    "wall": {"duration_s": 0.3},
}


@pytest.fixture(scope="package")
def run_folder(tmp_path_factory):
    """Folder of a short run of a scene."""
    made = {}

    def folder(name):
        if name not in made:
            out = tmp_path_factory.mktemp("runs") / name
            simulate(load_scene(name, SHORT[name])).save(out, pictures=False)
            made[name] = out
        return made[name]

    return folder


@pytest.fixture(scope="package")
def report_of(run_folder, tmp_path_factory):
    """Report of a short run of a scene."""
    made = {}

    def file(name):
        if name not in made:
            made[name] = report(
                run_folder(name), tmp_path_factory.mktemp("reports") / f"{name}.html"
            )
        return made[name]

    return file
