"""Sentences on the band of a run over the ranges of its constants."""

from collections.abc import Iterator

from tissue.simulation.run_folder import Summary

__all__ = ["band_lines"]

GREATEST = "greatest_"
"""Beginning of the name of a figure that is the largest value of a column or a field."""


def _band_text(band: Summary) -> str:
    """Describe the method of a band and the most important constants for the peak force."""
    asked = (
        f", {band['asked']} rounded up to a power of two"
        if band["asked"] & (band["asked"] - 1)
        else ""
    )
    totals = {name: index["total"] for name, index in band["sobol"].get("force_N.peak", {}).items()}
    first = sorted(totals, key=lambda name: -totals[name])[:3]
    shares = ", ".join(f"{name} {100.0 * totals[name]:.0f} %" for name in first)
    none = (
        "; no Sobol indices of the peak force: it does not vary, or a polynomial explains too "
        "little of it"
    )
    matters = f"; of the variance of the peak force: {shares}" if shares else none
    return f"{band['samples']} samples{asked}; {band['how']}{matters}"


def band_lines(band: Summary) -> Iterator[str]:
    """Yield sentences on a band: its samples, figures with 90 % intervals, and left-out samples."""
    yield _band_text(band)
    for name, ends in band.items():
        if name.startswith(GREATEST):
            quantity, _, unit = name.removeprefix(GREATEST).rpartition("_")
            yield f"greatest {quantity.replace('_', ' ')}: 90 % {_between(ends)} {unit}"
    for layer, ends in band.get("removed_mm3", {}).items():
        if ends["p95"] > 0.0:
            yield f"removed {layer}: 90 % {_between(ends)} mm³"
    for structure, figures in band.get("keep_clear", {}).items():
        yield f"least distance to {structure}: 90 % {_between(figures['least_distance_mm'])} mm"
    for sentence, event in band.get("events", {}).items():
        yield (
            f"{sentence}: in {event['share']:.0%} of the samples, 90 % at "
            f"{_between(event['time_s'])} s"
        )
    if "without" in band:
        names = ", ".join(name for name, why in band["without"].items() if "not vary" in why)
        yield f"on a given path these do not vary: {names}"
        if names := ", ".join(
            name for name, why in band["without"].items() if "not vary" not in why
        ):
            yield (
                "these depend on the constants and have no band, for the loads alone were "
                "reweighed (--each-run gives "
                f"one): {names}"
            )
    for name, why in band["problems"].items():
        yield f"{name} failed and is left out: {why}"
    if (span := band.get("span")) is not None and span["shortest_sample_s"] < span[
        "run_ends_s"
    ] - 0.5e-3:
        yield (
            f"samples end at different times, the first at {span['shortest_sample_s']:.3f} "
            "s: loads have a band to "
            f"{span['ends_s']:.3f} s, which {span['samples_at_end']} of {band['samples']} reach"
        )


def _between(ends: dict[str, float]) -> str:
    low = f"{ends['p05']:.4g}"
    high = f"{ends['p95']:.4g}"
    return f"{low} to {high}" if low != high else f"{low}, the same to four digits"
