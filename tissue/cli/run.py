"""``tissue run``."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any, TypedDict

from cyclopts import Parameter

from meshes.base.progress import silent
from tissue.cli.run_table import print_summary
from tissue.cli.terminal import console, left_out, progress, whole

if TYPE_CHECKING:
    from tissue.api.run import Run
    from tissue.scene.scene import Scene
    from tissue.simulation.live.slicer import SlicerLink

__all__ = ["run"]


def run(
    scene: str,
    /,
    *,
    out: Path | None = None,
    seed: Annotated[int | None, Parameter(converter=whole)] = None,
    duration_s: float | None = None,
    set_: Annotated[tuple[str, ...], Parameter(name="--set", negative="")] = (),
    fidelity: Annotated[tuple[str, ...], Parameter(negative="")] = (),
    compute: str = "cpu",
    cores: Annotated[int | None, Parameter(converter=whole)] = None,
    format_: Annotated[tuple[str, ...], Parameter(name="--format", negative="")] = (),
    pictures: str = "png",
    no_pictures: Annotated[bool, Parameter(negative="")] = False,
    band: Annotated[int | None, Parameter(converter=whole)] = None,
    workers: Annotated[int | None, Parameter(converter=whole)] = None,
    scheduler: str | None = None,
    each_run: Annotated[bool, Parameter(negative="")] = False,
    live: Annotated[bool, Parameter(negative="")] = False,
    web: Annotated[bool, Parameter(negative="")] = False,
    slicer: Annotated[bool, Parameter(negative="")] = False,
    slicer_port: Annotated[int | None, Parameter(converter=whole)] = None,
    slicer_drives: Annotated[bool, Parameter(negative="")] = False,
    ros2: Annotated[bool, Parameter(negative="")] = False,
    max_memory_GB: Annotated[float | None, Parameter(name="--max-memory-GB")] = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    allow_unstable: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Simulate a scene and write its trace, bone and pictures.

    Parameters
    ----------
    scene
        Name of a built-in scene (see `tissue scenes`) or a TOML file.
    out
        Folder to write; default runs/NAME.
    seed
        Seed of every random draw: of a device's run, and of a band's samples.
    duration_s
        Simulated time in seconds; one that holds the whole motion is longer by the hand's reaction time, under 1 s.
    set_
        KEY=VALUE, replaces an entry of the scene, such as voxels.spacing_mm=0.2; may be repeated.
    fidelity
        force_error=0.03 or tick_ms=0.7: take the cheapest settings of this machine that meet it; may be repeated.
    compute
        Device for the kernels: cpu or cuda:0.
    cores
        Processor cores to use; default all. The trace does not depend on it.
    format_
        Further formats beside CSV: parquet, npz, mat, h5 of the trace, or recording, HDF5 in volumetric_drilling's
        layout; may be repeated.
    pictures
        Format of the pictures: png, svg or pdf. In svg and pdf lines and text stay such, and what is shown in 3D is an
        image of 400 pixels an inch.
    no_pictures
        Draw none.
    band
        Samples of the constants in their ranges, such as 200: forces, torques and figures with 50 and 90 % bands.
    workers
        Processes that run the samples of a band beside each other, where each is a run of its own.
    scheduler
        tcp://HOST:PORT or tls://HOST:PORT: run the samples of a band on the workers of that Dask scheduler instead.
    each_run
        Run every sample of a band where reweighing the loads would do, so that temperature and stress have bands too.
    live
        Run against the wall clock, in a window with mouse and keys as device, or without a display scripted.
    web
        With --live: in a browser on this machine, at an address that is printed, in place of a window.
    slicer
        With --live: publish the run for 3D Slicer and other programs on this machine by OpenIGTLink.
    slicer_port
        With --slicer: port to publish at; default 18944.
    slicer_drives
        With --slicer: the transform tissue-target of 3D Slicer moves the tool, and no window opens.
    ros2
        With --live: publish pose, velocity and force on topics of ROS 2, /tissue/measured_cp and so on.
    max_memory_GB
        Memory that a file of the scene may take, in GB; default half of the free memory.
    overwrite
        Replace the run that the folder already holds.
    allow_unstable
        Run a device whose coupling is unstable, too.
    """
    from meshes.base.file_limits import memory_limit
    from tissue.simulation.picture_format import picture_format
    from tissue.simulation.run_folder import RunFolder
    from tissue.simulation.trace_files import check_format

    for kind in format_:
        check_format(kind)
    picture_format(pictures)
    overrides = _overrides(set_, fidelity, duration_s=duration_s)
    _refuse_web(web, live=live)
    left_out("without --live", "give --live", ros2=ros2 and not live)
    link = _slicer_link(slicer, slicer_port, slicer_drives, live=live)
    by_hand = web or slicer_drives
    loaded = _load(scene, overrides, live=live, by_hand=by_hand)
    if seed is not None and (band is None or loaded.device is not None):  # without a device it is that of a band alone
        loaded = _load(scene, overrides | {"seed": seed}, live=live, by_hand=by_hand)
    _refuse_unused(loaded, live=live, compute=compute, cores=cores, allow_unstable=allow_unstable)
    if band is not None:
        left_out("with --live", "run the scene without it", band=band if live else None)
        from tissue.uncertainty.band import require_band

        require_band(loaded, band, workers, scheduler, each_run=each_run)
    else:
        given: dict[str, object] = {"workers": workers, "scheduler": scheduler, "each_run": each_run}
        left_out("without --band", "give --band 200, or remove it", **given)
    folder = out or Path("runs") / loaded.name
    RunFolder.check(folder, overwrite=overwrite)
    started = perf_counter()
    settings: _Settings = {
        "compute": compute, "cores": cores, "out": folder, "overwrite": overwrite, "allow_unstable": allow_unstable,
    }  # fmt: skip
    with memory_limit(max_memory_GB), _naming_stop(folder):
        finished = _simulated(loaded, settings, live=live, web=web, link=link, ros2=ros2, duration_s=duration_s)
        simulated = perf_counter()
        with progress() as report:
            finished.save(folder, formats=format_, pictures=False if no_pictures else pictures, progress=report)
        if band is not None:
            with progress() as report:
                drawn = False if no_pictures else pictures
                finished.band(
                    band, seed=seed, workers=workers, scheduler=scheduler, each_run=each_run, compute=compute,
                    cores=cores, pictures=drawn, progress=report,
                )  # fmt: skip
    print_summary(finished.summary, folder, wall_s=perf_counter() - started, saving_s=perf_counter() - simulated)


def _overrides(changes: Sequence[str], fidelity: Sequence[str], *, duration_s: float | None) -> dict[str, Any]:
    """Entries of the scene that the options replace, by key."""
    from tissue.scene.load import parse_override

    overrides = dict(parse_override(text) for text in changes)
    for text in fidelity:
        key, value = parse_override(text, option="--fidelity", example="force_error=0.03")
        overrides[f"fidelity.{key}"] = value
    if duration_s is not None:
        overrides["duration_s"] = duration_s
    return overrides


def _load(scene: str, overrides: dict[str, Any], *, live: bool, by_hand: bool) -> "Scene":
    """The scene; a live one is moved by a page or 3D Slicer, or by a window where there is a display."""
    from tissue.scene.load import load_scene
    from tissue.system.offscreen import await_display

    return load_scene(scene, overrides, live=live and (by_hand or await_display() is None))


def _refuse_web(web: bool, *, live: bool) -> None:
    """Refuse a page for a run that is not live, or that nobody can serve."""
    left_out(
        "without --live", "give --live, or see a run that has ended by `tissue view DIR --web`", web=web and not live
    )
    if web:
        from tissue.simulation.live.page import require_web

        require_web()


def _slicer_link(slicer: bool, port: int | None, drives: bool, *, live: bool) -> "SlicerLink | None":
    """The link with 3D Slicer that is asked for."""
    left_out("without --live", "give --live, or open the files of a run that has ended", slicer=slicer and not live)
    if not slicer:
        left_out("without --slicer", "give --live --slicer, or remove it", slicer_port=port, slicer_drives=drives)
        return None
    from tissue.simulation.live.slicer import PORT, SlicerLink

    opened = lambda address: console.print(f"3D Slicer: connect a client to {address}")  # noqa: E731
    return SlicerLink(port=PORT if port is None else port, drives=drives, opened=opened)


def _refuse_unused(scene: "Scene", *, live: bool, compute: str, cores: int | None, allow_unstable: bool) -> None:
    """Refuse options that the scene does not use."""
    by_hand = scene.device is not None or live
    left_out("without a device", "set device = touch, or remove it", allow_unstable=allow_unstable and not by_hand)
    if scene.anatomy.kind in ("wall", "layers"):
        there = compute if compute != "cpu" else None
        left_out(f"for a {scene.anatomy.kind}, which no kernel computes", "remove it", cores=cores, compute=there)


def _simulated(
    scene: "Scene",
    settings: "_Settings",
    *,
    live: bool,
    web: bool,
    link: "SlicerLink | None",
    ros2: bool,
    duration_s: float | None,
) -> "Run":
    """The finished run, with its settings chosen where a fidelity is asked for."""
    chosen: dict[str, str] = {}
    # Live no progress bar: what draws it takes the interpreter from the ticks.
    with nullcontext(silent) if live else progress() as report:
        report("starting Warp", 0.0)
        from tissue.api.run import Run
        from tissue.api.simulate import simulate
        from tissue.figures.report import draw_pictures

        if not live:
            return simulate(scene, progress=report, **settings)
        from tissue.simulation.live.run import live as simulate_live
        from tissue.simulation.live.run import moved_by

        if scene.fidelity is not None:
            from tissue.evaluation.charts.fidelity import with_fidelity

            scene, chosen["fidelity"] = with_fidelity(scene, report=report)
        console.print(f"live: {moved_by(scene, web=web, slicer=link is not None and link.drives)[1]}; Ctrl-C ends it")
        opened = (lambda address: console.print(f"open {address}")) if web else None
        finished = simulate_live(scene, duration_s=duration_s, opened=opened, slicer=link, ros2=ros2, **settings)
    finished.parts.notes |= chosen
    finished.draw = draw_pictures
    return Run(finished)


class _Settings(TypedDict):
    """What every run is given, live or not."""

    compute: str
    cores: int | None
    out: Path
    overwrite: bool
    allow_unstable: bool


@contextmanager
def _naming_stop(folder: Path) -> Iterator[None]:
    """Add to Ctrl-C or SIGTERM that nothing was written, where the folder is as it was before the run."""
    before = _written(folder)
    try:
        yield
    except KeyboardInterrupt as stopped:
        if _written(folder) == before:
            stopped.args = ("stopped before anything was written",)
        raise


def _written(folder: Path) -> tuple[int, int] | None:
    """Which summary a folder holds; None without any."""
    try:
        found = (folder / "summary.json").stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_ino
