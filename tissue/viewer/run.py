"""Check of a saved run's files before `tissue view` reads them."""

from meshes.base.isolated_parser import parse_isolated
from tissue.simulation.run_folder import SavedRun
from tissue.simulation.saved_fields import frames_of

__all__ = ["require_whole"]


def require_whole(saved: SavedRun) -> None:
    """Refuse a run whose bone or frames are damaged, before VTK reads them in this process, which it could end.

    Raises
    ------
    InputError
        If a file is damaged or lacks what it should hold; the message names it.
    """
    wanted = {"bone.vti": ["remaining", "layer", "density_kg_m3"]} if saved.complete else {}
    if (saved.path / "fields.pvd").is_file():
        wanted |= {name: [] for _, name in frames_of(saved.path)}
    there = {name: arrays for name, arrays in wanted.items() if (saved.path / name).is_file()}
    if there:
        parse_isolated(
            "meshes.surfaces.vtk_reading:check_vtk",
            saved.path,
            what="folder of a run",
            remedy="run the scene again",
            arrays_by_file=there,
        )
