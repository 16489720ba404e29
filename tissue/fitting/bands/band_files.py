"""Files of a band in the folder of a run.

They hold the quantiles over time, the samples, the pictures and the band's entry in the summary.
"""

import csv
import json
from pathlib import Path

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.file_limits import require_regular
from meshes.base.whole_file import whole_file
from tissue.fitting.bands.band import Band
from tissue.fitting.bands.figures import LEVELS
from tissue.fitting.bands.reweighed import CHANNELS
from tissue.fitting.bands.sample import sample_name
from tissue.show.figures.fit_pictures import draw_band, draw_sobol
from tissue.simulation.run_folder import added_to_run, files_of_run, read_summary

__all__ = ["read_band", "save_band"]

OVER_TIME = "band.csv"
SAMPLES = "band/samples.csv"
SEPARATOR = "|"
"""Between the entries of a figure's name in the header of the samples: a layer's name or a
sentence may hold a dot.
"""


def save_band(band: Band, folder: Path, *, kind: str | None) -> None:
    """Write a band into the folder of its run and replace an earlier band.

    Pictures are drawn if `kind` names their format.

    Raises
    ------
    InputError
        If the folder holds no run, or another process writes to it.
    """
    summary = read_summary(folder)
    with added_to_run(folder):
        for old in _earlier_samples(folder):
            old.unlink()
        names = [f"{channel}_{level}" for channel in CHANNELS for level in LEVELS]
        quantiles = np.moveaxis(band.quantiles, 0, 2).reshape(len(band.times_s), -1)
        rows = np.column_stack([band.times_s, band.nominal, quantiles])
        _write(folder / OVER_TIME, ["time_s", *CHANNELS, *names], rows)
        held = (folder / SAMPLES).parent
        held.mkdir(exist_ok=True)
        for number, text in enumerate(band.files):
            with whole_file(held / sample_name(number, len(band.files))) as temporary:
                temporary.write_text(text, "utf-8")
        figures = [SEPARATOR.join(name) for name in band.figure_names]
        table = np.column_stack([band.numbers, band.values, band.figures])
        _write(folder / SAMPLES, ["sample", *band.constants, *figures], table)
        if kind is not None:
            (folder / "pictures").mkdir(exist_ok=True)
            title = str(summary["scene"])
            draw_band(
                band.times_s,
                band.nominal,
                band.quantiles,
                folder / "pictures" / f"band.{kind}",
                title=title,
            )
            draw_sobol(
                band.summary["sobol"], folder / "pictures" / f"band_sobol.{kind}", title=title
            )
        with whole_file(folder / "summary.json") as temporary:
            temporary.write_text(
                json.dumps(summary | {"band": band.summary}, indent=2) + "\n", "utf-8"
            )


def _earlier_samples(folder: Path) -> list[Path]:
    """Return the files of an earlier band's samples."""
    held = (folder / SAMPLES).parent
    names = (folder / name for name in files_of_run(folder))
    return [path for path in names if path.parent == held and path.suffix == ".toml"]


def read_band(folder: Path) -> Band:
    """Read the band in a run's folder.

    Raises
    ------
    InputError
        If there is no band, or a file is damaged.
    """
    held = read_summary(folder).get("band")
    if held is None:
        raise InputError("run", "have a band", f"none in {folder}", "make one with run.band(200)")
    (_, times) = _read(folder / OVER_TIME)
    (header, samples) = _read(folder / SAMPLES)
    constants = tuple(held["constants"])
    width = 1 + len(constants)
    nominal = times[:, 1 : 1 + len(CHANNELS)]
    quantiles = times[:, 1 + len(CHANNELS) :]
    if quantiles.shape[1] != len(CHANNELS) * len(LEVELS) or tuple(header[1:width]) != constants:
        raise InputError(
            "band.csv", "be as run.band wrote it", f"another one in {folder}", "make the band again"
        )
    over = np.moveaxis(quantiles.reshape(len(times), len(CHANNELS), len(LEVELS)), 2, 0)
    names = tuple(tuple(name.split(SEPARATOR)) for name in header[width:])
    numbers = samples[:, 0].astype(np.int64)
    return Band(
        times[:, 0],
        nominal,
        over,
        constants,
        samples[:, 1:width],
        names,
        samples[:, width:],
        numbers,
        (),
        held,
    )


def _write(path: Path, names: list[str], rows: Array) -> None:
    with whole_file(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(names)
        np.savetxt(file, rows, fmt="%.9g", delimiter=",")


def _read(path: Path) -> tuple[list[str], Array]:
    require_regular(path)
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return next(csv.reader(file)), np.loadtxt(file, delimiter=",", ndmin=2)
    except (OSError, ValueError, StopIteration):
        raise InputError(
            path.name, "be a table of numbers", f"another one in {path}", "make the band again"
        ) from None
