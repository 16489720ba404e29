"""``tissue run``."""

from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from cyclopts import Parameter

from meshes.base.progress import silent
from tissue.cli.terminal import (
    Flag,
    Formats,
    MaybeWhole,
    MemoryGB,
    Overrides,
    Texts,
    console,
    left_out,
    print_notes,
    print_table,
)
from tissue.system.progress import progress

if TYPE_CHECKING:
    from tissue.scene.scene import Scene
    from tissue.simulation.live.run import LiveSettings
    from tissue.simulation.run_folder import Summary


def print_summary(summary: "Summary", folder: Path, *, wall_s: float, saving_s: float) -> None:
    """Print the summary of a run as a table."""
    from tissue.show.report.page import band_lines, run_rows

    rows = run_rows(summary)
    band = summary.get("band")
    for name, key, unit in (("force", "force_N", "N"), ("torque", "torque_Nm", "N m")):
        # If the tool touches nothing, there is no band.
        if band is not None and band[key]["peak"]["p95"] > 0.0:
            rows.append((f"{name}, 90 % of {band['samples']} samples", _ends(band[key], unit)))
    if heat := summary.get("bone_heat"):
        rises = f"{heat['largest_rise_K']:.1f} / {heat['rise_at_half_mm_K']:.2f} K"
        rows.append(("rise of the remaining bone, largest / 0.5 mm from the cut", rises))
    if "late_us" in summary:
        rows += _rows_by_clock(summary)
    rows.append(("writing files and pictures", f"{saving_s:.1f} s"))
    done = f"{summary['scene']}: {summary['simulated_s']:g} s simulated in {wall_s:.1f} s"
    print_table(("quantity", "value"), rows, caption=done)
    for event in summary["events"]:
        console.print(f"at {event['time_s']:.3f} s: {event['what']}")
    for name, note in summary["notes"].items():
        console.print(f"{name}: {note}")
    if band is not None:
        for line in band_lines(band):
            console.print(f"band: {line}")
    console.print(f"files in {folder}")


def _rows_by_clock(summary: "Summary") -> Iterator[tuple[str, str]]:
    """Yield rows (title, text) on the scheduling and the delays of a run in real time."""
    if (gaps := summary.get("machine_gaps")) is not None:
        gap = f"scheduling gaps longer than {1e-3 * gaps['least_us']:g} ms"
        yield f"{gap} (expected in this run)", f"{gaps['expected_in_ticks']:.0f}"
        yield (
            f"{gap} (measured before and after the ticks)",
            f"{gaps['count']} in {gaps['spun_s']:.2g} s, the longest "
            f"{1e-3 * gaps['longest_us']:.0f} ms",
        )
    if (chosen := summary.get("scheduling")) is not None:
        large = f"{chosen['split_launches']} of {chosen['large_launches']} large ones"
        yield "kernel launches on several cores", f"{large}, {chosen['cores']} cores"
        if "background" in chosen:
            yield "during the ticks", chosen["background"]
    late = summary["late_us"]
    times = f"{late['median']:.0f} / {late['p99']:.0f} / {late['max']:.0f} µs"
    yield "delay of ticks, median / 99 % / max", times
    yield "wall clock skipped", f"{summary['skipped_ms']:.1f} ms"


def _ends(figures: dict[str, dict[str, float]], unit: str) -> str:
    """Return a text with the 90 % uncertainty intervals of peak and mean."""
    peak, mean = (
        f"{figures[name]['p05']:.3g}–{figures[name]['p95']:.3g}"
        for name in ("peak", "mean_in_contact")
    )
    return f"{peak} / {mean} {unit}"


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """Command-line options that change the scene.

    Attributes
    ----------
    seed
        Seed of all random draws: those of the simulated hand in a run with a device, and those of
        an uncertainty band.
    duration_s
        Simulated time in seconds. Default: the duration of the motion. If a run with a simulated
        hand reaches the end of the motion, 0.73 s (expert) to 0.9 s (novice) are added, so that the
        hand can come to rest.
    set_
        KEY=VALUE replaces an entry of the scene, such as voxels.spacing_mm=0.2; may be repeated.
    fidelity
        Required accuracy or speed: force_error=0.03 (relative force error) or tick_ms=0.7 (longest
        time per tick). The run uses settings that meet the requirement on this machine. May be
        repeated.
    """

    seed: MaybeWhole = None
    duration_s: float | None = None
    set_: Overrides = ()
    fidelity: Texts = ()


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class EngineOptions:
    """Command-line options for the computation.

    Attributes
    ----------
    compute
        Device that computes the kernels: cpu or cuda:0.
    cores
        Processor cores to use; default all. The trace does not depend on their number.
    max_memory_GB
        Memory that an input file of the scene may take, in GB; default half of the free memory.
    overwrite
        Replace the run that the folder already holds.
    allow_unstable
        Run even if the coupling between device and tool is predicted to be unstable.
    """

    compute: str = "cpu"
    cores: MaybeWhole = None
    max_memory_GB: MemoryGB = None
    overwrite: Flag = False
    allow_unstable: Flag = False


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class FileOptions:
    """Command-line options for the output files.

    Attributes
    ----------
    out
        Output folder (default: runs/NAME).
    format_
        Additional format of the trace: parquet, npz, mat or h5. The format `recording` is an HDF5
        file in the layout of the simulator volumetric_drilling. May be repeated.
    pictures
        Format of the pictures: png, svg or pdf. In svg and pdf, lines and text are vectors; 3D
        views are images with 400 pixels per inch.
    no_pictures
        Draw no pictures.
    """

    out: Path | None = None
    format_: Formats = ()
    pictures: str = "png"
    no_pictures: Flag = False


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class BandOptions:
    """Command-line options for uncertainty bands.

    Attributes
    ----------
    band
        Number of samples, such as 200, of the material constants in their published ranges. From
        these samples, 50 and 90 % uncertainty bands of forces, torques and summary values are
        computed.
    workers
        With --band: number of parallel processes. It has an effect only if each sample needs its
        own run.
    scheduler
        With --band: run the samples on the workers of the Dask scheduler at tcp://HOST:PORT or
        tls://HOST:PORT.
    each_run
        With --band: run the scene for every sample, instead of computing the loads of all samples
        from one run. Bands of temperature and stress are computed only with this option.
    """

    band: MaybeWhole = None
    workers: MaybeWhole = None
    scheduler: str | None = None
    each_run: Flag = False


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class LiveOptions:
    """Command-line options for a run in real time.

    Attributes
    ----------
    live
        Run in real time in a window, in which mouse and keys move the tool. Without a display, no
        window opens, and the tool follows the motion in the scene.
    web
        With --live: show the run in a browser on this machine instead of a window. The address of
        the page is printed.
    slicer
        With --live: publish the run with OpenIGTLink, for 3D Slicer and other programs on this
        machine.
    slicer_port
        With --slicer: port for OpenIGTLink; default 18944.
    slicer_drives
        With --slicer: the transform named tissue-target in 3D Slicer moves the tool. No window
        opens.
    ros2
        With --live: publish pose, velocity and force on ROS 2 topics, such as /tissue/measured_cp.
    """

    live: Flag = False
    web: Flag = False
    slicer: Flag = False
    slicer_port: MaybeWhole = None
    slicer_drives: Flag = False
    ros2: Flag = False


def run(
    scene: str,
    /,
    *,
    files: FileOptions = FileOptions(),
    scene_options: SceneOptions = SceneOptions(),
    engine: EngineOptions = EngineOptions(),
    band: BandOptions = BandOptions(),
    live: LiveOptions = LiveOptions(),
) -> None:
    """Simulate a scene and write its trace, bone and pictures.

    Parameters
    ----------
    scene
        Name of a built-in scene (see `tissue scenes`), or a TOML file.
    """
    from tissue.scene.load import load_scene
    from tissue.simulation.run_folder import RunFolder, picture_format
    from tissue.simulation.trace import check_format
    from tissue.system.offscreen import await_display

    for kind in files.format_:
        check_format(kind)
    picture_format(files.pictures)
    drawn = False if files.no_pictures else files.pictures
    overrides = _overrides(scene_options)
    how = _live_settings(live, scene_options.duration_s)
    by_hand = live.web or live.slicer_drives
    # A person moves the tool in a browser, in 3D Slicer or, if there is a display, in a window.
    is_driven = live.live and (by_hand or await_display() is None)
    loaded = load_scene(scene, overrides, live=is_driven)
    seed = scene_options.seed
    # otherwise the seed is used only for the band
    if seed is not None and (band.band is None or loaded.device is not None):
        loaded = load_scene(scene, overrides | {"seed": seed}, live=is_driven)
    _refuse_unused(loaded, engine)
    _check_band(loaded, band, live=live.live)
    folder = files.out or Path("runs") / loaded.name
    RunFolder.check(folder, overwrite=engine.overwrite)
    started = perf_counter()
    # In a live run, a progress bar would delay the ticks, which need the interpreter.
    with nullcontext(silent) if live.live else progress() as report:
        report("starting Warp", 0.0)
        from tissue.objects.simulate import simulate, simulate_live

        options = {"out": folder, "progress": report, **asdict(engine)}
        if how is None:
            finished = simulate(loaded, **options)
        else:
            print_notes()
            console.print(f"live: {how.mover(loaded)[1]}; Ctrl-C ends it")
            finished = simulate_live(loaded, how, **options)
    simulated = perf_counter()
    with progress() as report:
        finished.save(folder, formats=files.format_, pictures=drawn, progress=report)
    if band.band is not None:
        with progress() as report:
            finished.band(
                band.band,
                seed=seed,
                workers=band.workers,
                scheduler=band.scheduler,
                each_run=band.each_run,
                compute=engine.compute,
                cores=engine.cores,
                pictures=drawn,
                progress=report,
            )
    print_summary(
        finished.summary,
        folder,
        wall_s=perf_counter() - started,
        saving_s=perf_counter() - simulated,
    )


def _overrides(options: SceneOptions) -> dict[str, Any]:
    """Return the values that the options set, keyed by scene key."""
    from tissue.scene.load import parse_override, parse_overrides

    overrides = parse_overrides(options.set_)
    for text in options.fidelity:
        key, value = parse_override(text, option="--fidelity", example="force_error=0.03")
        overrides[f"fidelity.{key}"] = value
    if options.duration_s is not None:
        overrides["duration_s"] = options.duration_s
    return overrides


def _live_settings(options: LiveOptions, duration_s: float | None) -> "LiveSettings | None":
    """Return the settings of a live run; None for a run that is not live.

    Raises
    ------
    InputError
        If an option has no effect, or the package for the web server is not installed.
    """
    if not options.live:
        remedy = "give --live, or show a finished run by `tissue view DIR --web`"
        left_out("without --live", remedy, web=options.web)
        remedy = "give --live, or open the files of a finished run"
        left_out("without --live", remedy, ros2=options.ros2, slicer=options.slicer)
    if not options.slicer:
        idle = {"slicer_port": options.slicer_port, "slicer_drives": options.slicer_drives}
        left_out("without --slicer", "give --live --slicer, or remove this option", **idle)
    if not options.live:
        return None
    from tissue.simulation.live.publisher import PORT, SlicerLink
    from tissue.simulation.live.run import LiveSettings
    from tissue.simulation.live.window import require_web

    if options.web:
        require_web()
    link = None
    if options.slicer:
        link = SlicerLink(
            port=PORT if options.slicer_port is None else options.slicer_port,
            drives=options.slicer_drives,
            opened=lambda address: console.print(f"3D Slicer: connect a client to {address}"),
        )
    opened = (lambda address: console.print(f"open {address}")) if options.web else None
    return LiveSettings(duration_s=duration_s, opened=opened, slicer=link, ros2=options.ros2)


def _refuse_unused(scene: "Scene", engine: EngineOptions) -> None:
    """Raise an error if an option has no effect in the scene."""
    idle = engine.allow_unstable and scene.device is None
    left_out("without a device", "set device = touch, or remove this option", allow_unstable=idle)
    if scene.anatomy.kind in ("wall", "layers"):
        there = engine.compute if engine.compute != "cpu" else None
        left_out(
            f"for a {scene.anatomy.kind}, which needs no kernels",
            "remove it",
            cores=engine.cores,
            compute=there,
        )


def _check_band(scene: "Scene", options: BandOptions, *, live: bool) -> None:
    """Check the options for uncertainty bands; without --band, there must be none."""
    if options.band is None:
        left_out("without --band", "give --band 200, or remove this option", **asdict(options))
        return
    left_out("with --live", "run the scene without --live", band=options.band if live else None)
    from tissue.fitting.bands.band import require_band

    require_band(scene, options.band, options.workers, options.scheduler, each_run=options.each_run)
