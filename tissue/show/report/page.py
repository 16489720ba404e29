"""Text of a report as HTML: key figures, bands, events, notes, materials, scene and versions."""

from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from meshes.base.errors import counted
from tissue.scene.used_constants import Used
from tissue.simulation.run_folder import SavedRun, Summary
from tissue.system.html import html_list, html_picture

Text = Callable[[str], str]
"""Function that converts a plain text to cleaned and escaped HTML."""
CONFIDENCE = {"H": "high", "M": "medium", "L": "low"}


def status_of(saved: SavedRun, text: Text) -> str:
    """Return the scene description as HTML, with a note if the run is incomplete."""
    scene = saved.scene
    described = (
        f"<p>{text(scene.description)}</p>" if scene is not None and scene.description else ""
    )
    if saved.complete:
        return described
    problem = f": {text(saved.problem)}" if saved.problem else ""
    sentence = (
        f"This run is {text(saved.status)}{problem}. The report has the results that it wrote."
    )
    return f'{described}<p class="verdict open">{sentence}</p>'


def figures_of(saved: SavedRun, text: Text) -> str:
    """Return HTML cards with the key figures of a run; empty if the run is incomplete."""
    # the summary of an incomplete run has no figures
    if not saved.complete:
        return ""
    shown = (
        f'<div class="card"><span>{text(label)}</span><b>{text(value)}</b></div>'
        for label, value in run_rows(saved.summary)
    )
    return f'<div class="cards">{"".join(shown)}</div>'


def run_rows(summary: Summary) -> list[tuple[str, str]]:
    """Return the names and values of a run's key figures as text.

    For an incomplete run, the status and the problem are returned instead.
    """
    if summary["status"] != "complete":
        rows = [("status", str(summary["status"]))]
        if problem := summary.get("problem"):
            rows.append(("problem", str(problem)))
        return rows
    force = summary["force_N"]
    torque = summary["torque_Nm"]
    tick = summary["tick_us"]
    left_s = summary.get("left_region_s")
    valid = "" if left_s is None else f" (not valid after {left_s:.3f} s)"
    until = ""
    if left_s is not None:
        until = f" (up to {left_s:.3f} s; the tool then left the simulated region)"
    # The distances come first, because a breach matters more than any other result.
    rows = [
        (f"smallest distance to {name}", f"{_distance_text(each)}{until}")
        for name, each in summary.get("keep_clear", {}).items()
    ]
    rows.append(("simulated", f"{summary['simulated_s']:g} s"))
    if summary["cuts"]:
        start = summary["start_mm3"]
        rows += [
            # The rest of the bone is not simulated, so its volume is not known.
            (f"removed {layer}", f"{removed:.3g} of the simulated {start[layer]:.4g} mm³{valid}")
            for layer, removed in summary["removed_mm3"].items()
            if start[layer] > 0.0
        ]
    if (rise := summary.get("largest_rise")) is not None:
        rising = ", still rising at the end" if rise["rising_at_end"] else ""
        rows.append(
            (
                f"largest temperature rise of the {rise['tissue']}",
                f"{rise['rise_K']:.2f} K at {rise['time_s']:.3g} s{rising}{valid}",
            )
        )
    if (apart := summary.get("path_distance_mm")) is not None:
        rows.append(
            (
                "largest distance from the path, in contact / in the whole run",
                f"{apart['largest_in_contact']:.3g} / {apart['largest']:.3g} mm{valid}",
            )
        )
    if (inserted_mm := summary.get("largest_insertion_mm")) is not None:
        rows.append(("inserted, largest", f"{inserted_mm:.3g} mm"))
    # Only the summary of an organ with a hyperelastic law has this table.
    law = summary.get("law", {}).get("solve_ms")
    solves = (
        [("solve of the law, median / 99 %", f"{law['median']:.3g} / {law['p99']:.3g} ms")]
        if law
        else []
    )
    return [
        *rows,
        (
            "force, peak / mean in contact",
            f"{force['peak']:.3g} / {force['mean_in_contact']:.3g} N{valid}",
        ),
        (
            "torque, peak / mean in contact",
            f"{torque['peak']:.3g} / {torque['mean_in_contact']:.3g} N m{valid}",
        ),
        (
            "tick, median / 99 % / max",
            f"{tick['median']:.0f} / {tick['p99']:.0f} / {tick['max']:.0f} µs",
        ),
        (
            "missed 1 ms deadlines",
            f"{summary['missed_deadlines']} of {summary['simulated_s'] * 1e3:.0f}",
        ),
        *solves,
    ]


def _distance_text(kept: Summary) -> str:
    """Return a text with the breach of a structure, or the smallest distance without a breach."""
    where = ""
    # Runs of earlier versions have neither time nor place of the smallest distance.
    if "least_distance_tip_mm" in kept:
        # 0.0 turns a rounded -0.0 into 0
        tip = ", ".join(f"{round(each, 3) + 0.0:g}" for each in kept["least_distance_tip_mm"])
        where = f" at {kept['least_distance_at_s']:.3f} s, tip at ({tip}) mm"
    if (breach_s := kept.get("first_breach_s")) is not None:
        breach = f"breached, {kept['breach_depth_mm']:.2g} mm deep, first at {breach_s:.3f} s"
        return f"{breach}, deepest{where}" if where else breach
    distance = f"{kept['least_distance_mm']:.3f} mm{where}"
    if "margin_mm" not in kept:
        return distance
    if (first_s := kept["first_below_margin_s"]) is None:
        return f"{distance}, margin of {kept['margin_mm']:g} mm kept"
    return f"{distance}, closer than the margin of {kept['margin_mm']:g} mm from {first_s:.3f} s"


def assessment_section(lines: Sequence[str], picture: bytes, text: Text) -> str:
    """Return an HTML section with the text lines and the PNG picture of an assessment."""
    shown = html_picture("trainee and reference over time", picture)
    return f"<h2>Assessment</h2>{html_list(lines, text)}{shown}"


def events_table(summary: Summary, text: Text) -> str:
    """Return the HTML table of events.

    A button in each row shows the run at the time of the event.
    """
    rows = [
        (
            str(number),
            f'<button data-time="{event["time_s"]:.6f}">{event["time_s"]:.3f} s</button>',
            text(event["what"]),
        )
        for number, event in enumerate(summary.get("events", []), 1)
    ]
    return _table(("", "time", "what happened"), rows)


def notes_table(summary: Summary, text: Text) -> str:
    """Return the HTML table of the notes of a run."""
    notes = summary.get("notes", {})
    rows = [(text(str(name)), text(str(note))) for name, note in notes.items()]
    return _table(("of", "note"), rows)


def materials_table(used: Sequence[Used], text: Text) -> str:
    """Return the HTML table of the constants used, with value, range, confidence and source."""
    if not used:
        return (
            "<p>This scene rests on no cited constant: what it is made of is stated in the scene "
            "itself.</p>"
        )
    low = sum(one.cited.confidence == "L" for one in used)
    rows = []
    for one in used:
        value = f"{one.cited.value:g}"
        if one.stated is not None:
            value = f"<b>{one.stated:g}</b> (scene; cited {value})"
        span = f"{one.cited.low:g} to {one.cited.high:g}"
        sure = CONFIDENCE.get(one.cited.confidence, one.cited.confidence)
        rows.append((text(one.of), text(one.name), value, span, text(sure), text(one.cited.source)))
    sentence = (
        f"<p>{counted(len(used), 'cited constant')}, {low} of them of low confidence (assumed, "
        "or read in an abstract). "
        "The range is what is plausible; results move with it.</p>"
    )
    header = ("of", "constant, with its unit", "value", "range", "confidence", "source")
    return sentence + _table(header, rows, numbers=(2, 3))


def reproduce(scene_text: str, versions: Iterable[tuple[str, str]], text: Text) -> str:
    """Return HTML sections with the scene, the commands to repeat the run, and the versions.

    `versions` contains pairs (name, version) for programs and for the machine.
    """
    data = b64encode(scene_text.encode()).decode("ascii")
    keep = (
        f'<a download="scene.toml" href="data:application/toml;base64,{data}">save it as '
        "scene.toml</a>"
    )
    commands = (
        "pip install .    # in a checkout of tissue\n"
        "tissue run scene.toml --out again\ntissue report again"
    )
    rows = [(text(name), text(value)) for name, value in versions]
    return (
        f"<h2>Scene</h2><p>Everything that was used; {keep}. Files that it names are without "
        "their folders.</p>"
        f"<details><summary>scene.toml</summary><pre>{text(scene_text)}</pre></details>"
        f"<h2>Run it again</h2><pre>{text(commands)}</pre>"
        "<p>The same version of tissue gives the same trace bit for bit on the same kind of "
        "processor.</p>"
        f"<h2>Versions and machine</h2>{_table(('', ''), rows)}"
    )


def _table(
    header: Sequence[str], rows: Sequence[Sequence[str]], *, numbers: Sequence[int] = ()
) -> str:
    """Return a table from cells in HTML; columns of numbers align to the right."""

    if not rows:
        return "<p>None.</p>"

    def line(cells: Sequence[str], element: str) -> str:
        shown = ""
        for column, cell in enumerate(cells):
            look = ' class="number"' if column in numbers else ""
            shown += f"<{element}{look}>{cell}</{element}>"
        return f"<tr>{shown}</tr>"

    head = f"<thead>{line(header, 'th')}</thead>" if any(header) else ""
    body = "".join(line(row, "td") for row in rows)
    return f'<div class="scroll"><table>{head}<tbody>{body}</tbody></table></div>'


ROWS = (
    ("peak force", "force_N", "peak", "N"),
    ("mean force in contact", "force_N", "mean_in_contact", "N"),
    ("peak torque", "torque_Nm", "peak", "N m"),
    ("mean torque in contact", "torque_Nm", "mean_in_contact", "N m"),
)
ENDS = ("p25", "p75"), ("p05", "p95")
"""Quantiles at the ends of the 50 % and the 90 % band."""
BAND_PICTURES = {
    "band": "loads over time with their bands",
    "band_sobol": "which constant matters",
}
SECTION = {
    "section": "Section through the tool, with the layers and the structures to keep clear of."
}
PICTURES = {"png": "image/png", "svg": "image/svg+xml"}
"""Picture formats that a page can show, with their media types."""


def band_section(saved: SavedRun, text: Text) -> str:
    """Return the HTML section on the uncertainty band of a run, with table and pictures.

    The result is an empty string if the run has no band.
    """
    band: dict[str, Any] | None = saved.summary.get("band")
    if band is None or not saved.complete:
        return ""
    rows = []
    for label, outer, inner, unit in ROWS:
        at = band[outer][inner]
        spans = (f"{at[low]:.3g} to {at[high]:.3g}" for low, high in ENDS)
        value = saved.summary[outer].get(inner, 0.0)
        rows.append((f"{label} / {unit}", f"{value:.3g}", f"{at['p50']:.3g}", *spans))
    sentence = (
        f"{counted(len(band['constants']), 'constant')} in their ranges. The error of the model "
        "itself is not in it."
    )
    table = _table(("figure", "this run", "median", "50 %", "90 %"), rows)
    lines = html_list(band_lines(band), text)
    return f"<h2>Bands</h2><p>{sentence}</p>{table}{lines}{pictures_of(saved, BAND_PICTURES)}"


def pictures_of(saved: SavedRun, captions: Mapping[str, str]) -> str:
    """Return the HTML of a run's pictures; `captions` is keyed by file name without suffix."""
    found = []
    for name, about in captions.items():
        for ending, kind in PICTURES.items():
            path = saved.path / "pictures" / f"{name}.{ending}"
            if path.is_file():
                shown = html_picture(about, path.read_bytes(), kind)
                found.append(f"<figure>{shown}<figcaption>{about}</figcaption></figure>")
    return "".join(found)


LARGEST_PREFIX = "greatest_"
"""Prefix of the names of numbers in a summary that are maxima of a column or a field."""


def _band_text(band: Summary) -> str:
    """Return a text on the method of an uncertainty band, and on the most important constants.

    These constants have the largest influence on the peak force.
    """
    asked = f", {band['asked']} asked for" if band["asked"] != band["samples"] else ""
    totals = {name: index["total"] for name, index in band["sobol"].get("force_N.peak", {}).items()}
    first = sorted(totals, key=lambda name: -totals[name])[:3]
    shares = ", ".join(f"{name} {100.0 * totals[name]:.0f} %" for name in first)
    matters = (
        f"total Sobol indices of the peak force: {shares}; an interaction counts for every "
        "constant in it, so the sum may exceed 100 %"
    )
    if not shares:
        explained = band.get("surrogate_explains", {}).get("force_N.peak")
        why = "it does not vary"
        if explained is not None:
            share = 100.0 * max(explained, 0.0)
            why = (
                f"the polynomial fitted to the samples explains only {share:.0f} % of its "
                "variance; more samples may help"
            )
        matters = f"no Sobol indices of the peak force, because {why}"
    return f"{band['samples']} samples{asked}; {band['how']}; {matters}"


def band_lines(band: Summary) -> Iterator[str]:
    """Yield sentences about an uncertainty band.

    The sentences state the number of samples, the 90 % intervals of summary values, and the names
    of failed samples. The intervals do not include the failed samples.
    """
    yield _band_text(band)
    for name, ends in band.items():
        if name.startswith(LARGEST_PREFIX):
            quantity, _, unit = name.removeprefix(LARGEST_PREFIX).rpartition("_")
            yield f"largest {quantity.replace('_', ' ')}: 90 % {_between(ends)} {unit}"
    for layer, ends in band.get("removed_mm3", {}).items():
        if ends["p95"] > 0.0:
            yield f"removed {layer}: 90 % {_between(ends)} mm³"
    for structure, figures in band.get("keep_clear", {}).items():
        yield f"smallest distance to {structure}: 90 % {_between(figures['least_distance_mm'])} mm"
    for sentence, event in band.get("events", {}).items():
        yield (
            f"{sentence}: in {event['share']:.0%} of the samples, 90 % at "
            f"{_between(event['time_s'])} s"
        )
    without = band.get("without", {})
    for why in dict.fromkeys(without.values()):
        names = ", ".join(name for name, reason in without.items() if reason == why)
        yield f"without a band: {names} ({why})"
    for name, why in band["problems"].items():
        yield f"{name} failed and is left out: {why}"
    # half a tick covers the rounding of times
    if (span := band.get("span")) is not None and span["shortest_sample_s"] < span[
        "run_ends_s"
    ] - 0.5e-3:
        yield (
            f"samples end at different times, the first at {span['shortest_sample_s']:.3f} "
            f"s: loads have a band up to {span['ends_s']:.3f} s, the time that "
            f"{span['samples_at_end']} of {band['samples']} samples reach"
        )


def _between(ends: dict[str, float]) -> str:
    low = f"{ends['p05']:.4g}"
    high = f"{ends['p95']:.4g}"
    return f"{low} to {high}" if low != high else f"{low}, equal to four digits"
