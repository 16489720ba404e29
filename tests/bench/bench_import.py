"""Time and memory from a CT of 512 x 512 x 300 voxels to the first force.

They cover `tissue import` and the run after it.

    python tests/bench/bench_import.py

The CT is the synthetic one of `examples/ct/synthetic_ct.py`, interpolated to that size, as NIfTI.
"""

import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import nibabel
import numpy as np
from scipy.ndimage import zoom

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples/ct"))
from synthetic_ct import ct_phantom

SIZE = (512, 512, 300)


def write_ct(path: Path) -> None:
    """Write the CT, its noise added after the interpolation, which would smooth it."""
    rng = np.random.default_rng(0)
    image = ct_phantom(rng, noise_HU=0.0).image()
    factors = [n / m for n, m in zip(SIZE, image.values.shape, strict=True)]
    values = zoom(image.values.astype(np.float32), factors, order=1)
    values += rng.normal(0.0, 20.0, values.shape).astype(np.float32)
    spacing = np.array(image.spacing_mm) / factors
    affine = np.diag([-spacing[0], -spacing[1], spacing[2], 1.0])
    affine[:3, 3] = np.array(image.origin_mm) * [-1.0, -1.0, 1.0]
    stored = nibabel.Nifti1Image(np.rint(np.clip(values, -1024, 3071)).astype(np.int16), affine)
    stored.header.set_xyzt_units("mm")
    nibabel.save(stored, path)


def timed(*words: str) -> float:
    """Seconds that a command takes."""
    start = perf_counter()
    subprocess.run([sys.executable, "-m", "tissue", *words], check=True, stdout=subprocess.DEVNULL)
    return perf_counter() - start


def main() -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_ct(folder / "ct.nii.gz")
        crop = ("--crop=0,-45,-52,80,30,52",)
        made = timed(
            "import",
            str(folder / "ct.nii.gz"),
            *crop,
            "--site",
            "humeral-head",
            "--out",
            str(folder / "a"),
        )
        ran = timed(
            "run", str(folder / "a" / "scene.toml"), "--out", str(folder / "run"), "--no-pictures"
        )
        peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6
    print(f"import {made:.1f} s, run of 5 s {ran:.1f} s, at most {peak:.2f} GB")


if __name__ == "__main__":
    main()
