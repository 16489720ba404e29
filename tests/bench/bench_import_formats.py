"""Imports of one bone from a CT in four formats, a tilted series and a threshold.

Printed are the site, volume and force of each.

python tests/bench/bench_import_formats.py

The CT is made by `python examples/ct/synthetic_ct.py`. Forces belong to the imported scene in
voxels of 0.25 mm. They are compared tick by tick with the forces of the import from DICOM by its
label.
"""

import json
import re
import sys
import tempfile
from pathlib import Path

import numpy as np

import tissue

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples/ct"))
from synthetic_ct import HEAD_CENTRE_MM, HEAD_RADIUS_MM
from synthetic_ct import main as write_phantom

CROP_MM = ((0.0, -45.0, -52.0), (80.0, 30.0, 52.0))


def main() -> None:
    """Import, run and print."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_phantom([str(folder)])
        label = {
            "labels": folder / "labels.nii.gz",
            "label_names": str(folder / "labels.toml"),
            "region": "humerus_left",
        }
        threshold = {"crop_mm": CROP_MM, "site": "humeral-head"}
        cases = {source: (source, label) for source in ("dicom", "ct.nii.gz", "ct.nrrd", "ct.mha")}
        cases |= {
            "threshold": ("ct.nii.gz", threshold),
            "tilted, threshold": ("dicom_tilted", threshold),
        }
        reference = None
        for case, (source, options) in cases.items():
            made = tissue.import_ct(
                folder / source, folder / "out", overwrite=True, pictures=False, **options
            )
            record = json.loads((made.folder / "import.json").read_text("utf-8"))
            centre, axis = (
                np.array(record["site"]["centre_mm"]),
                np.array(record["site"]["rotation"])[:, 2],
            )
            force = tissue.simulate(
                tissue.load_scene(made.scene, {"voxels.spacing_mm": 0.25})
            ).trace["force_z_N"]
            sentence = next(each for each in made.sentences if each.startswith("site:"))
            radius = float(re.search(r"of radius ([\d.]+) mm", sentence)[1])
            off = np.linalg.norm(centre - radius * axis - HEAD_CENTRE_MM)
            now = (force, centre, record["bone_mm3"])
            reference = reference or now
            peak = reference[0].max()
            print(
                f"{case}: peak {force.max():.2f} N ({force.max() / peak - 1.0:+.2%}), mean "
                f"{force.mean() / reference[0].mean() - 1.0:+.2%}, ticks within "
                f"{np.abs(force - reference[0]).max() / peak:.3%}"
                f" of the peak; site {np.linalg.norm(centre - reference[1]):.2f} mm from the "
                "first; "
                f"{1e-3 * record['bone_mm3']:.2f} ml "
                f"({record['bone_mm3'] / reference[2] - 1.0:+.2%}), threshold "
                f"{record['threshold']}; head's radius {radius:g} of {HEAD_RADIUS_MM:g} mm, "
                f"its centre {off:.2f} mm off"
            )


if __name__ == "__main__":
    main()
