"""Names of the files that a run writes into its folder."""

from pathlib import Path

from tissue.scene.registry import ANATOMIES
from tissue.simulation.picture_format import PICTURE_FORMATS
from tissue.simulation.trace_files import FORMATS

__all__ = ["named_as_run_files", "run_file_names"]

FILES = (
    "trace.csv",
    *(f"trace.{kind}" for kind in FORMATS),
    "recording.hdf5",
    "timing.csv",
    "scene.toml",
    "summary.json",
    "bone.vti",
    "bone.nrrd",
    "bone.stl",
    "bone.vtp",
    "carving.pvd",
    "carving/poses.npz",
    "carving/rest.vtp",
    f"carving/frame_{4 * '[0-9]'}.vtp",
    "fields.pvd",
    f"fields/frame_{4 * '[0-9]'}.vtu",
    "band.csv",
    "band/samples.csv",
    *(f"band/sample_{digits * '[0-9]'}.toml" for digits in range(1, 7)),
    "report.html",
)
"""Names of a run's files in its folder, without the pictures."""
PICTURES = (
    "band",
    "band_sobol",
    "bone_before_after",
    "force_depth",
    "force_torque",
    "held",
    "insertion",
    "played",
    "press",
    "removed_depth",
    "section",
    "wall",
)
"""Names of pictures that runs of any scene may have; a kind of anatomy may add others."""


def run_file_names() -> tuple[str, ...]:
    """Return the names of all files that a run may write, some with ``[0-9]`` for a digit."""
    added = {Path(name).stem for kind in ANATOMIES.known for name in ANATOMIES[kind].pictures}
    stems = sorted({*PICTURES, *added})
    return (*FILES, *(f"pictures/{stem}.{kind}" for stem in stems for kind in PICTURE_FORMATS))


def named_as_run_files(path: Path) -> set[str]:
    """Return the names of plain files in a folder that are names of a run's files."""
    found = {each.relative_to(path).as_posix() for name in run_file_names() for each in path.glob(name)}
    return {name for name in found if (path / name).is_file() and not (path / name).is_symlink()}
