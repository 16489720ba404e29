"""Print the comparison with published measurements: python tests/validation/report.py [PICTURE]

With a path, a picture of measured against predicted figures is written.
"""

import sys
from pathlib import Path

import drilling
import numpy as np
from predictions import Compared, compared, fitted, ratios
from published import DataSet, data_sets

__all__ = ["main", "set_is_inside"]

WITHIN = 0.15
"""Largest error of a ratio over speed or feed that counts as agreement."""


def set_is_inside(key: str, *, pull_free: bool = False) -> bool:
    """Return whether the band contains every measured figure of a set."""
    return all(each.inside_pull_free if pull_free else each.inside for each in compared(key))


def coverage(keys: list[str], *, pull_free: bool = False) -> str:
    """Return the number of sets whose band contains all their figures."""
    count = sum(set_is_inside(key, pull_free=pull_free) for key in keys)
    return f"{count} of {len(keys)} ({count / len(keys):.0%})"


def width(band: tuple[float, float]) -> str:
    """Return the ratio of the ends of a band."""
    low, high = band
    if high == low:
        return "1"
    return "below 0" if low <= 0.0 else f"{high / low:.3g}"


def _line(each: Compared) -> str:
    floor = "" if each.floor is None else f"{each.floor:.0%}"
    return (
        f"  {each.label:58} {each.measured:8.3g} {floor:>5} {each.predicted:8.3g} "
        f"{each.band[0]:8.3g} {each.band[1]:8.3g} {width(each.band):>8} "
        f"{'yes' if each.inside else 'NO':>4} {each.pull_free[0]:8.3g} {each.pull_free[1]:8.3g} "
        f"{'yes' if each.inside_pull_free else 'NO':>4}"
    )


def print_sets(sets: dict[str, DataSet]) -> None:
    """Print measured values, predictions and bands of all sets."""
    print(
        f"  {'figure':58} {'measured':>8} {'noise':>5} {'cited':>8} {'p05':>8} {'p95':>8} "
        f"{'width':>8} {'in':>4} {'p05*':>8} {'p95*':>8} {'in*':>4}   * axial coefficients 0"
    )
    for key, data in sets.items():
        print(f"{data.name} [{key}; {data.role}]")
        for each in compared(key):
            print(_line(each))


def print_fits(sets: dict[str, DataSet]) -> None:
    """Print the errors after fitting one or two factors to half of the rows."""
    print("\nfit on half of the rows: factors, RMS relative error on the fitted and the other half")
    for key, data in sets.items():
        for factors in (1, 2):
            found = fitted(key, factors)
            if found is not None:
                print(
                    f"  {data.name:42} {factors}: chip {found.chip:6.2f}, edge {found.edge:6.2f}; "
                    f"{found.fit_error:6.1%} {found.test_error:6.1%}"
                )


def print_ratios(sets: dict[str, DataSet]) -> None:
    """Print ratios over speed and feed, without any fit."""
    print("\nratios at cited constants")
    for key, data in sets.items():
        for each in ratios(key):
            floor = "" if each.floor is None else f"noise {each.floor:.0%}"
            print(
                f"  {data.name:42} {each.kind:5} {each.label:68} {each.measured:6.3f} "
                f"{each.predicted:6.3f} {each.error:+7.1%} {floor}"
            )


def print_variants(sets: dict[str, DataSet]) -> None:
    """Print what each refinement of law and drill changes."""
    print(
        "\nvariants: typical factor of absolute error; ratio errors; held-out error, 1 and 2 factors"
    )
    for name in drilling.VARIANTS:
        print(
            f"  {name:46} "
            + "; ".join(f"{k} {v:.3g}" for k, v in variant_errors(sets, name).items())
        )


def variant_errors(sets: dict[str, DataSet], name: str) -> dict[str, float]:
    """Return the errors of a variant over all drilling sets that are no source of constants."""
    from predictions import measured_of, nominal, row_loads

    logs = []
    errors = []
    held: dict[int, list[float]] = {1: [], 2: []}
    for key, data in sets.items():
        errors += [each.error for each in ratios(key, name) if each.kind != "both"]
        if data.law != "drill":
            continue
        for row in data.rows:
            loads = row_loads(data, row, nominal(data, name))
            for quantity, unit, value, _ in measured_of(row):
                logs.append(abs(np.log(float(getattr(loads, f"{quantity}_{unit}")[0]) / value)))
        for factors, found in held.items():
            fit = fitted(key, factors, name)
            if fit is not None:
                found.append(fit.test_error)
    sizes = np.abs(errors)
    return {
        "factor": float(np.exp(np.median(logs))),
        "ratio rms": float(np.sqrt(np.mean(sizes**2))),
        "ratios within 15 %": float(np.mean(sizes <= WITHIN)),
        "held out 1": float(np.median(held[1])),
        "held out 2": float(np.median(held[2])),
    }


def main(picture: Path | None = None) -> None:
    """Print all tables and write the picture."""
    sets = data_sets()
    print_sets(sets)
    tests = [key for key, data in sets.items() if data.role != "source"]
    free = [key for key in tests if sets[key].role == "test"]
    known = [key for key in tests if sets[key].set_up_known]
    print("\nsets whose band contains all figures (in brackets: axial coefficients 0)")
    for label, keys in (
        ("sets that are no source", tests),
        ("of these, that bound no range", free),
        ("of these, with a stated set-up", known),
    ):
        print(f"  {label:34} {coverage(keys)}  [{coverage(keys, pull_free=True)}]")
    print_fits(sets)
    print_ratios(sets)
    print_variants(sets)
    if picture is not None:
        from picture import draw

        draw(picture)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
