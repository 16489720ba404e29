"""Write the synthetic CT of a humerus, a vertebra and density rods: ``python -m meshes.ct phantom``."""

import argparse
import sys

import numpy as np

from meshes.base.errors import InputError
from meshes.ct.phantom import ct_phantom
from meshes.ct.phantom_files import write_phantom, write_stored

__all__ = ["main"]


def main(words: list[str] | None = None) -> int:
    """Write a phantom into a folder as its arguments ask; the exit status."""
    parser = argparse.ArgumentParser(prog="python -m meshes.ct", description=__doc__)
    parser.add_argument("folder", help="where to write dicom/, dicom_tilted/, ct.nii.gz, ct.nrrd, ct.mha and labels")
    parser.add_argument("--energy-keV", type=float, default=70.0, help="effective energy, 70 by default")
    parser.add_argument("--noise-HU", type=float, default=20.0, help="standard deviation of a voxel, 20 by default")
    parser.add_argument("--seed", type=int, default=0, help="of the noise")
    parser.add_argument("--tilt-deg", type=float, default=12.0, help="tilt of the gantry in dicom_tilted")
    asked = parser.parse_args(words)
    rng = np.random.default_rng(asked.seed)
    try:
        straight, tilted = (
            ct_phantom(rng, energy_keV=asked.energy_keV, noise_HU=asked.noise_HU, tilt_deg=tilt)
            for tilt in (0.0, asked.tilt_deg)
        )
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    folder = write_phantom(asked.folder, straight)
    write_stored(folder / "dicom_tilted", tilted.stored, tilt_deg=asked.tilt_deg)
    print(f"{folder}: a CT of {straight.stored.values.shape} voxels in four formats, its labels and truth.json")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
