"""Print the comparison with published measurements: python tests/validation/report.py [PICTURE]

With a path, a picture of measured against predicted figures is written.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import drilling
import numpy as np
from predictions import Compared, compared, fitted, log_errors, ratios
from published import DataSet, data_sets

from meshes.base.arrays import Array

__all__ = ["VariantErrors", "controlled", "main", "ratio_errors", "set_is_inside", "variant_errors"]

WITHIN = 0.15
"""Largest error of a ratio over speed or feed that counts as agreement."""


def set_is_inside(key: str) -> bool:
    """Return whether the band contains every measured figure of a set."""
    return all(each.inside for each in compared(key))


def coverage(keys: list[str]) -> str:
    """Return the number of sets whose band contains all their figures."""
    count = sum(set_is_inside(key) for key in keys)
    return f"{count} of {len(keys)} ({count / len(keys):.0%})"


def figure_coverage(keys: list[str]) -> str:
    """Return the number of figures inside their bands."""
    inside = [each.inside for key in keys for each in compared(key)]
    return f"{sum(inside)} of {len(inside)} ({np.mean(inside):.0%})"


def width(band: tuple[float, float]) -> str:
    """Return the ratio of the ends of a band."""
    low, high = band
    return f"{high / low:.3g}"


def _line(each: Compared) -> str:
    noise = "" if each.noise is None else f"{each.noise:.0%}"
    return (
        f"  {each.label:58} {each.measured:8.3g} {noise:>5} {each.predicted:8.3g} "
        f"{each.band[0]:8.3g} {each.band[1]:8.3g} {width(each.band):>8} "
        f"{'yes' if each.inside else 'NO':>4}"
    )


def print_sets(sets: dict[str, DataSet]) -> None:
    """Print measured values, predictions and bands of all sets."""
    print(
        f"  {'figure':58} {'measured':>8} {'noise':>5} {'cited':>8} {'p05':>8} {'p95':>8} "
        f"{'width':>8} {'in':>4}"
    )
    for key, data in sets.items():
        print(f"{data.name} [{key}; {data.role}]")
        for each in compared(key):
            print(_line(each))


def print_summary(sets: dict[str, DataSet]) -> None:
    """Print one line per set, as in `docs/validation.md`."""
    print(
        "\n| data set | inside the band | width | predicted / measured | held-out error | noise |"
    )
    print("|---|---|---|---|---|---|")
    for key, data in sets.items():
        figures = compared(key)
        count = sum(each.inside for each in figures)
        widths = [each.band[1] / each.band[0] for each in figures]
        factor = np.exp(np.mean([np.log(each.predicted / each.measured) for each in figures]))
        fit = fitted(key, 2) or fitted(key, 1)
        noises = [each.noise for each in figures if each.noise is not None]
        print(
            f"| {data.name} | {count} of {len(figures)} | {np.median(widths):.3g} | {factor:.2g} | "
            f"{'' if fit is None else f'{fit.test_error:.0%}'} | "
            f"{f'{np.mean(noises):.0%}' if noises else ''} |"
        )


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
            noise = "" if each.noise is None else f"noise {each.noise:.0%}"
            print(
                f"  {data.name:42} {each.label:68} {each.measured:6.3f} "
                f"{each.predicted:6.3f} {each.error:+7.1%} {noise}"
            )
    print(f"\nratios within {WITHIN:.0%}")
    for label, keys in (("controlled sets", controlled(sets)), ("all sets", list(sets))):
        for kind in ("speed", "feed"):
            errors = ratio_errors(keys, kind)
            count = int((np.abs(errors) <= WITHIN).sum())
            print(f"  {label}, over {kind}: {count} of {len(errors)}")


def controlled(sets: dict[str, DataSet]) -> list[str]:
    """Return the drilling sets whose source states speed and feed of at least two rows."""
    return [
        key
        for key, data in sets.items()
        if data.law == "drill" and data.set_up_known and len(data.rows) > 1
    ]


def ratio_errors(keys: list[str], kind: str, variant: str = drilling.DEFAULT) -> Array:
    """Return the relative errors of the ratios of one kind."""
    return np.array(
        [each.error for key in keys for each in ratios(key, variant) if each.kind == kind]
    )


@dataclass(frozen=True)
class VariantErrors:
    """Errors of a variant of law and drill over some sets.

    Attributes
    ----------
    factor
        Typical factor between prediction and measured load at cited constants: exponential of the
        root mean square logarithm.
    speed, feed, arm
        Root mean squares of the relative errors of ratios over speed, over feed, and of torque over
        thrust.
    held_one, held_two
        Root mean squares of the relative errors on the held-out half, one and two factors fitted.
    """

    factor: float
    speed: float
    feed: float
    arm: float
    held_one: float
    held_two: float


def variant_errors(keys: list[str], name: str) -> VariantErrors:
    """Return the errors of a variant over drilling sets."""
    logarithms = np.concatenate([log_errors(key, name) for key in keys])
    held = []
    for factors in (1, 2):
        fits = [fitted(key, factors, name) for key in keys]
        held.append(_rms(np.array([each.test_error for each in fits if each is not None])))
    arms = ratio_errors(keys, "torque over thrust", name)
    return VariantErrors(
        float(np.exp(_rms(logarithms))),
        _rms(ratio_errors(keys, "speed", name)),
        _rms(ratio_errors(keys, "feed", name)),
        _rms(arms),
        held[0],
        held[1],
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def print_variants(sets: dict[str, DataSet]) -> None:
    """Print what each refinement changes, over the controlled sets."""
    keys = controlled(sets)
    print(
        "\nvariants over the controlled sets: factor of absolute error; RMS errors of ratios over "
        "speed, feed, torque over thrust; held-out half with one and two factors"
    )
    for name in drilling.VARIANTS:
        each = variant_errors(keys, name)
        print(
            f"  {name:44} {each.factor:5.2f} {each.speed:6.1%} {each.feed:6.1%} {each.arm:6.1%} "
            f"{each.held_one:6.1%} {each.held_two:6.1%}"
        )


def main(picture: Path | None = None) -> None:
    """Print all tables and write the picture."""
    sets = data_sets()
    print_sets(sets)
    tests = [key for key, data in sets.items() if data.role != "source"]
    free = [key for key in tests if sets[key].role == "test"]
    print("\nsets whose band contains all figures")
    for label, keys in (
        ("sets that are no source", tests),
        ("that bound no range either", free),
        ("no source, stated set-up", [key for key in tests if sets[key].set_up_known]),
        ("bound no range, stated set-up", [key for key in free if sets[key].set_up_known]),
    ):
        print(f"  {label:34} {coverage(keys)}; figures: {figure_coverage(keys)}")
    print_summary(sets)
    print_fits(sets)
    print_ratios(sets)
    print_variants(sets)
    if picture is not None:
        from picture import draw

        draw(picture)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
