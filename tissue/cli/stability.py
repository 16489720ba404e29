"""``tissue stability``."""

from pathlib import Path

from meshes.base.errors import InputError
from tissue.cli.terminal import Flag, Overrides, Texts, console, left_out, problems
from tissue.system.progress import progress


def stability(
    scene: str | None = None,
    /,
    *,
    set_: Overrides = (),
    out: Path | None = None,
    only: Texts = (),
    overwrite: Flag = False,
) -> None:
    """Report the stability of the haptic device in a scene, or make the stability atlas.

    With a scene, the command reports whether the coupling between device and tool is stable. It
    also computes a map of the largest stable stiffness as a function of damping and delay. Without
    a scene, it makes the atlas in about three minutes. Each page of the atlas shows a case in which
    one method of force rendering fails.

    Parameters
    ----------
    scene
        Name of a built-in scene, or a TOML file. Without a scene, the atlas is made.
    set_
        KEY=VALUE replaces an entry of the scene, such as device=six-dof; may be repeated.
    out
        Output folder. With a scene, the picture and the data of the stability map are written to
        it; default none. For the atlas, the default is the folder atlas.
    only
        Name of a page of the atlas, such as wall_map. Only this page is made. May be repeated.
    overwrite
        Replace the map or the atlas that the folder already holds.
    """
    if scene is None:
        if set_:
            raise InputError(
                "--set",
                "be given with a scene",
                f"{set_[0]} without a scene",
                "name the scene before --set",
            )
        _atlas(out or Path("atlas"), only, overwrite=overwrite)
        return
    if only:
        raise InputError(
            "--only", "be given without a scene", f"{only[0]} with {scene}", "remove the scene"
        )
    if out is None:
        left_out(
            "with a scene and no --out, because no file is written",
            "remove it",
            overwrite=overwrite,
        )
    from tissue.evaluation.stability_report import (
        FILES,
        scene_stability,
        stability_lines,
        write_stability_files,
    )
    from tissue.scene.load import load_scene, parse_overrides
    from tissue.system.owned_folder import require_folder

    if out is not None:
        require_folder(out, "map", FILES, overwrite=overwrite)
    loaded = load_scene(scene, parse_overrides(set_))
    with problems.status("running the loop at many stiffnesses"):
        found = scene_stability(loaded)
    console.print(*stability_lines(loaded, found), sep="\n")
    if out is not None:
        written = write_stability_files(loaded, found, out, overwrite=overwrite)
        console.print(f"files in {out}: {', '.join(path.name for path in written)}")


def _atlas(folder: Path, only: tuple[str, ...], *, overwrite: bool) -> None:
    """Make the atlas and report the result of each page."""
    with progress() as report:
        report("loading methods", 0.0)
        from tissue.evaluation.atlas import PAGES
        from tissue.evaluation.atlas.page import chosen_pages, write_atlas

        pages = chosen_pages(PAGES, only)
        entries = write_atlas(folder, pages, overwrite=overwrite, progress=report)
    for entry in entries:
        mark = "ok " if entry.shown else "OPEN"
        console.print(f"{mark:4} {entry.page.name:19} {entry.took_s:5.1f} s  {entry.page.title}")
    good = sum(entry.shown for entry in entries)
    seconds = sum(entry.took_s for entry in entries)
    console.print(
        f"{good} of {len(entries)} pages show the limit of their method, and that the engine stays "
        "valid, falls back or refuses there. "
        f"The pages took {seconds:.0f} s; open {folder / 'index.html'}"
    )
