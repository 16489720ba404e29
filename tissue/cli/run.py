"""``tissue run``."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any, TypedDict

from cyclopts import Parameter

from meshes.base.progress import silent
from tissue.cli.terminal import console, left_out, progress, whole

if TYPE_CHECKING:
    from tissue.api.run import Run
    from tissue.scene.scene import Scene
    from tissue.simulation.run_summary import Summary

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
    ros2: Annotated[bool, Parameter(negative="")] = False,
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
        dask://ADDRESS: run the samples of a band on the workers of that Dask scheduler instead.
    each_run
        Run every sample of a band where reweighing the loads would do, so that temperature and stress have bands too.
    live
        Run against the wall clock, in a window with mouse and keys as device, or without a display scripted.
    web
        With --live: in a browser on this machine, at an address that is printed, in place of a window.
    ros2
        With --live: publish pose, velocity and force on topics of ROS 2, /tissue/measured_cp and so on.
    overwrite
        Replace the run that the folder already holds.
    allow_unstable
        Run a device whose coupling is unstable, too.
    """
    from tissue.simulation.picture_format import picture_format
    from tissue.simulation.run_folder import RunFolder
    from tissue.simulation.trace_files import check_format

    for kind in format_:
        check_format(kind)
    picture_format(pictures)
    overrides = _overrides(set_, fidelity, duration_s=duration_s)
    _refuse_web(web, live=live)
    left_out("without --live", "give --live", ros2=ros2 and not live)
    loaded = _load(scene, overrides, live=live, web=web)
    if seed is not None and (band is None or loaded.device != "none"):  # without a device it is that of a band alone
        loaded = _load(scene, overrides | {"seed": seed}, live=live, web=web)
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
    with _naming_stop(folder):
        finished = _simulated(loaded, settings, live=live, web=web, ros2=ros2, duration_s=duration_s)
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
    _print_summary(finished.summary, folder, wall_s=perf_counter() - started, saving_s=perf_counter() - simulated)


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


def _load(scene: str, overrides: dict[str, Any], *, live: bool, web: bool) -> "Scene":
    """The scene; a live one is moved by a page, or by a window where there is a display."""
    from tissue.scene.load import load_scene
    from tissue.system.offscreen import await_display

    return load_scene(scene, overrides, live=live and (web or await_display() is None))


def _refuse_web(web: bool, *, live: bool) -> None:
    """Refuse a page for a run that is not live, or that nobody can serve."""
    left_out(
        "without --live", "give --live, or see a run that has ended by `tissue view DIR --web`", web=web and not live
    )
    if web:
        from tissue.simulation.live.page import require_web

        require_web()


def _refuse_unused(scene: "Scene", *, live: bool, compute: str, cores: int | None, allow_unstable: bool) -> None:
    """Refuse options that the scene does not use."""
    by_hand = scene.device != "none" or live
    left_out("without a device", "set device = touch, or remove it", allow_unstable=allow_unstable and not by_hand)
    if scene.anatomy.kind in ("wall", "layers"):
        there = compute if compute != "cpu" else None
        left_out(f"for a {scene.anatomy.kind}, which no kernel computes", "remove it", cores=cores, compute=there)


def _simulated(
    scene: "Scene", settings: "_Settings", *, live: bool, web: bool, ros2: bool, duration_s: float | None
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
        console.print(f"live: {moved_by(scene, web=web)[1]}; Ctrl-C ends it")
        opened = (lambda address: console.print(f"open {address}")) if web else None
        finished = simulate_live(scene, duration_s=duration_s, opened=opened, ros2=ros2, **settings)
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


def _print_summary(summary: "Summary", folder: Path, *, wall_s: float, saving_s: float) -> None:
    """The table a person reads after a run."""
    from rich.table import Table

    table = Table(title=f"{summary['scene']}: {summary['simulated_s']:g} s simulated in {wall_s:.1f} s")
    table.add_column("quantity")
    table.add_column("value", justify="right")
    for layer, removed in summary["removed_mm3"].items() if summary["cuts"] else ():
        table.add_row(f"removed {layer}", f"{removed:.2f} of {summary['start_mm3'][layer]:.1f} mm³")
    band = summary.get("band")
    for name, key, unit in (("force", "force_N", "N"), ("torque", "torque_Nm", "N·m")):
        table.add_row(f"{name}, peak / mean in contact", _pair(summary[key], unit))
        if band is not None and band[key]["peak"]["p95"] > 0.0:
            table.add_row(f"{name}, 90 % of {band['samples']} samples", _ends(band[key], unit))
    tick = summary["tick_us"]
    table.add_row("tick, median / 99 % / max", f"{tick['median']:.0f} / {tick['p99']:.0f} / {tick['max']:.0f} µs")
    table.add_row("missed 1 ms deadlines", f"{summary['missed_deadlines']} of {summary['simulated_s'] * 1e3:.0f}")
    for quantity, value in _scheduling_rows(summary):
        table.add_row(quantity, value)
    if "late_us" in summary:
        late = summary["late_us"]
        table.add_row(
            "delay of ticks, median / 99 % / max", f"{late['median']:.0f} / {late['p99']:.0f} / {late['max']:.0f} µs"
        )
        table.add_row("wall clock skipped", f"{summary['skipped_ms']:.1f} ms")
    table.add_row("writing files and pictures", f"{saving_s:.1f} s")
    console.print(table)
    for event in summary["events"]:
        console.print(f"at {event['time_s']:.3f} s: {event['what']}")
    for name, note in summary["notes"].items():
        console.print(f"{name}: {note}")
    if band is not None:
        from tissue.uncertainty.sentences import band_lines

        for line in band_lines(band):
            console.print(f"band: {line}")
    console.print(f"files in {folder}")


def _scheduling_rows(summary: "Summary") -> Iterator[tuple[str, str]]:
    """How late the machine itself was, and what was chosen for launches and background work."""
    if (gaps := summary.get("machine_gaps")) is not None:
        met = f"{gaps['count']} in {gaps['spun_s']:.2g} s, longest {1e-3 * gaps['longest_us']:.2g} ms"
        over = f"gaps of the machine over {1e-3 * gaps['least_us']:g} ms, expected in these ticks"
        yield over, f"{gaps['expected_in_ticks']:.1f} ({met})"
    if (chosen := summary.get("scheduling")) is not None:
        large = f"{chosen['split_launches']} of {chosen['large_launches']} large ones"
        yield "launches split over cores", f"{large}, {chosen['cores']} cores"
        if "background" in chosen:
            yield "while the ticks go on", chosen["background"]


def _pair(figures: dict[str, float], unit: str) -> str:
    return f"{figures['peak']:.3g} / {figures['mean_in_contact']:.3g} {unit}"


def _ends(figures: dict[str, dict[str, float]], unit: str) -> str:
    """Ends of the 90 % intervals of the peak and of the mean."""
    peak, mean = (f"{figures[name]['p05']:.3g}–{figures[name]['p95']:.3g}" for name in ("peak", "mean_in_contact"))
    return f"{peak} / {mean} {unit}"
