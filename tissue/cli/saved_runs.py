"""Commands on saved runs: ``tissue assess``, ``compare``, ``report`` and ``view``."""

from contextlib import nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from meshes.base.progress import silent
from tissue.cli.terminal import Flag, Formats, Texts, console, left_out, print_table
from tissue.system.progress import progress


def assess(
    folder: Path,
    /,
    *,
    against: Path,
    force_limit_n: Annotated[float | None, Parameter(name="--force-limit-N")] = None,
    deviation_limit_mm: float | None = None,
    overshoot_limit_mm: float | None = None,
    out: Path | None = None,
    overwrite: Flag = False,
) -> None:
    """Compare a trainee's run with a reference run of the same scene, or rank trainees.

    Parameters
    ----------
    folder
        Folder of the trainee's run, written by `tissue run`. To rank trainees: a folder that
        contains one folder for each trainee. A trainee's folder is the folder of a run, or contains
        one such folder for each attempt.
    against
        Folder of the reference run.
    force_limit_n
        Largest allowed force, in newtons; default 1.25 times the peak force of the reference run.
    deviation_limit_mm
        Largest allowed distance from the path of the reference run, in mm; default 1. The limit
        applies at positions where the tool of either run touches the tissue.
    overshoot_limit_mm
        Largest allowed distance of the tip below the deepest point of the reference run, in mm;
        default 0.5.
    out
        Output folder for the picture and the results. Without this option, the results are only
        printed.
    overwrite
        Replace the assessment or ranking that the folder already holds.
    """
    from tissue.evaluation import assessment_files, ranking
    from tissue.objects.assess import Assessment, Ranking, rank
    from tissue.objects.assess import assess as assessed
    from tissue.system.owned_folder import require_folder

    limits = {
        "force_limit_N": force_limit_n,
        "deviation_limit_mm": deviation_limit_mm,
        "overshoot_limit_mm": overshoot_limit_mm,
    }
    given = {name: value for name, value in limits.items() if value is not None}
    several = folder.is_dir() and not ranking.is_run(folder)
    if out is None:
        left_out("without --out, because no file is written", "remove it", overwrite=overwrite)
    elif several:
        require_folder(out, "ranking", ranking.FILES, overwrite=overwrite)
    else:
        require_folder(out, "assessment", assessment_files.FILES, overwrite=overwrite)
    found: Assessment | Ranking
    found = rank(folder, against, **given) if several else assessed(folder, against, **given)
    console.print(str(found))
    if out is not None:
        written = found.save(out, overwrite=overwrite)
        console.print(f"files in {out}: {', '.join(path.name for path in written)}")


def compare(
    *folders: Path,
    out: Path | None = None,
    over: Literal["time", "depth"] | None = None,
    format_: Formats = (),
    overwrite: Flag = False,
) -> None:
    """Compare the scenes, results and forces of runs with those of the first run.

    Parameters
    ----------
    folders
        Folders of two or more runs that `tissue run` wrote.
    out
        Folder for the picture and the table. Without this option, the results are only printed.
    over
        Horizontal axis of the picture: time, or depth of the tool's tip below its first contact,
        for a needle along its axis. The default is depth if, in every run, the depth is more than
        half of the length of the tip's path in contact.
    format_
        Format of the picture: png, svg or pdf; default png. The formats parquet, npz, mat and h5
        write one table with the traces of all runs. May be repeated.
    overwrite
        Replace the comparison that the folder already holds.
    """
    from tissue.objects.comparison import FILES, KIND, split_formats
    from tissue.objects.comparison import compare as compared
    from tissue.system.owned_folder import require_folder

    if out is None:
        left_out("without --out, because no file is written", "remove it", overwrite=overwrite)
        left_out(
            "without --out, because nothing is drawn",
            "remove it",
            over=over,
            format=format_,
        )
    split_formats(format_)
    if out is not None:
        require_folder(out, KIND, FILES, overwrite=overwrite)
    found = compared(*folders)
    titles, rows = found.texts()
    if rows:
        print_table(titles, rows)
    console.print(*found.lines(), sep="\n")
    if out is not None:
        written = found.save(out, over=over, formats=format_, overwrite=overwrite)
        console.print(f"files in {out}: {', '.join(path.name for path in written)}")


def report(
    folder: Path,
    /,
    *,
    out: Path | None = None,
    against: Path | None = None,
    force_limit_n: Annotated[float | None, Parameter(name="--force-limit-N")] = None,
    deviation_limit_mm: float | None = None,
    overshoot_limit_mm: float | None = None,
    overwrite: Flag = False,
) -> None:
    """Write a report on a run as one HTML file, which needs no network.

    Parameters
    ----------
    folder
        Folder of a run, written by `tissue run`.
    out
        HTML file to write; default report.html in the folder of the run.
    against
        Folder of a reference run. If given, the report also contains the comparison of `tissue
        assess` with this run.
    force_limit_n
        With --against: largest allowed force, in newtons; default 1.25 times the peak force of the
        reference run.
    deviation_limit_mm
        With --against: largest allowed distance from the path of the reference run, in mm; default
        1.
    overshoot_limit_mm
        With --against: largest allowed distance of the tip below the deepest point of the reference
        run, in mm; default 0.5.
    overwrite
        Replace an existing file.
    """
    from tissue.objects.run import report as write

    limits = {
        "force_limit_N": force_limit_n,
        "deviation_limit_mm": deviation_limit_mm,
        "overshoot_limit_mm": overshoot_limit_mm,
    }
    if against is None:
        left_out("without --against", "give --against DIR, or remove this option", **limits)
    with progress() as shown:
        written = write(
            folder,
            out,
            against=against,
            **limits,
            overwrite=overwrite,
            progress=shown,
        )
    console.print(f"{written}: {written.stat().st_size / 1e6:.1f} MB")


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class DrawingOptions:
    """Command-line options for the drawing.

    Attributes
    ----------
    hide
        Name of a tissue layer or organ part that is hidden at first; may be repeated.
    field
        Computed field that is shown at first, for example von_mises_MPa.
    scale
        Factor by which the drawn displacement is multiplied at first.
    time_s
        Time that is shown at first, in seconds; default the time of the largest force.
    clean
        With --screenshot: draw only the tissue, on a transparent background.
    """

    hide: Texts = ()
    field: str | None = None
    scale: float = 1.0
    time_s: float | None = None
    clean: Flag = False


def view(
    folder: Path,
    /,
    *,
    screenshot: Path | None = None,
    movie: Path | None = None,
    drawing: DrawingOptions = DrawingOptions(),
    web: Flag = False,
    overwrite: Flag = False,
) -> None:
    """Show a run or an imported bone in a window.

    Parameters
    ----------
    folder
        Folder that `tissue run` or `tissue import` wrote. For an import, a click on the bone sets
        the place where the tool works.
    screenshot
        Write a picture to this .png file instead of opening a window.
    movie
        Write a movie to this .mp4 or .gif file instead of opening a window.
    web
        Show the run in a browser on this machine instead of a window. The address of the page is
        printed.
    overwrite
        Replace an existing file.
    """
    from tissue.show.viewer.run_scene import Choice
    from tissue.show.viewer.view import view as show

    def opened(address: str) -> None:
        console.print(f"open {address}\nCtrl-C ends the page.")

    with nullcontext(silent) if movie is None else progress() as report:
        shown = show(
            folder,
            Choice(**asdict(drawing)),
            screenshot=screenshot,
            movie=movie,
            overwrite=overwrite,
            progress=report,
            opened=opened if web else None,
        )
    console.print(shown)
