"""Choice of the cheapest setting with a demanded fidelity."""

from collections.abc import Sequence

from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from tissue.evaluation.charts.frontier import frontier_of
from tissue.evaluation.charts.law import with_law
from tissue.evaluation.charts.measure import BOUNDS, Measured
from tissue.evaluation.charts.reference import reference_words
from tissue.evaluation.charts.settings import Setting
from tissue.scene.coupling import Fidelity
from tissue.scene.load import changed
from tissue.scene.scene import Scene

__all__ = ["SAFETY", "choose", "with_fidelity"]

SAFETY = 1.5
"""Ratio of a demanded error to the largest allowed error of a setting at the measured places.

The margin keeps the error within the demand at other places. The value was set on seeds 1-10 of an
earlier force law. It was then tested on five further motions of each of four scenes and of four
imaged teeth and scapulae: every demand is kept. With 1.25, the demands of all but one tooth are
kept. With 1, a demand of 1 % is kept by two motions in five on another tooth
(tests/bench/held_out.py).
"""


def choose(points: Sequence[Measured], wanted: Fidelity, *, gap: float = 0.0) -> Measured:
    """Return the cheapest measurement that satisfies a demand.

    Without a demanded error, the most accurate measurement is returned. An error counts as at least
    `gap`, the uncertainty of the reference. Rows that are not settings are skipped.

    Raises
    ------
    InputError
        If no setting satisfies the demand. The message names the nearest setting.
    """
    settings = [point for point in points if point.family not in BOUNDS]

    def error_of(point: Measured) -> float:
        return max(SAFETY * point.force_error, gap)

    def excess(point: Measured) -> float:
        """Return the largest ratio of a measured to a demanded value."""
        error = 0.0 if wanted.force_error is None else error_of(point) / wanted.force_error
        tick = 0.0 if wanted.tick_ms is None else 1e-3 * point.p99_us / wanted.tick_ms
        return max(error, tick)

    fits = [point for point in settings if excess(point) <= 1.0]
    if fits and wanted.force_error is not None:
        return min(fits, key=lambda point: point.median_us)
    if fits:
        return min(fits, key=lambda point: point.force_error)
    nearest = min(settings, key=excess)
    raise InputError(
        "fidelity",
        f"be met by a setting of {nearest.scene} on this machine",
        _asked(wanted),
        (
            f"the nearest is {nearest.setting} with force_error = {error_of(nearest):.2g} and "
            f"tick_ms = {0.001 * nearest.p99_us:.2g}"
        ),
    )


def with_fidelity(scene: Scene, *, report: Progress = silent) -> tuple[Scene, str]:
    """Return a scene at the cheapest setting with its `fidelity`, and the reason of the choice.

    Settings that were not measured on this machine are measured first.

    Raises
    ------
    InputError
        If no setting satisfies the demand.
    """
    wanted = scene.fidelity
    if wanted is None:
        return scene, "as it is: no fidelity was asked for"
    plain = changed(scene, {"fidelity": None})
    found = frontier_of(plain, report=report)
    point = choose(found.points, wanted, gap=found.gap)
    setting = next(each for each in found.settings if each.name == point.setting)
    at, law = with_law(changed(plain, setting.changes), wanted)
    rank = "the cheapest" if wanted.force_error is not None else "the most accurate"
    sentence = (
        f"{_in_words(at, setting, found.settings)}: force {100.0 * point.force_error:.2g} % "
        "over ticks, "
        f"{100.0 * point.error_50_ms:.2g} % over 50 ms, from {reference_words(scene, found.gap)}; "
        f"tick {point.median_us:.0f} µs, 99 % {point.p99_us:.0f} µs, {rank} of "
        f"{len(found.points)} settings that meets "
        f"{_asked(wanted)}{law}"
    )
    leaves_out = [f"{point.leaves_out}, which no force needs"] if point.leaves_out else []
    late_ms = (
        0 if at.device is None else at.device.coupling.delay_ms + at.device.coupling.model_ms - 1
    )
    if at.device is not None and at.device.prediction in ("none", "hold") and late_ms > 0:
        leaves_out.append(f"prediction, so that the force comes up to {late_ms} ms late")
    if leaves_out:
        sentence += f"; leaves out {'; and '.join(leaves_out)}"
    return at, sentence


def _asked(wanted: Fidelity) -> str:
    """Return a demand as it was written."""
    return ", ".join(f"{name} = {value:g}" for name, value in wanted if value is not None)


def _in_words(scene: Scene, setting: Setting, among: Sequence[Setting]) -> str:
    """Describe a setting and the settings that it was chosen from."""
    if scene.device is None:
        return f"{setting.name}, of {'; '.join(each.name for each in among)}"
    foresight = {"none": "no prediction", "hold": "the tissue's last force held"}
    predictor = foresight.get(
        scene.held.prediction, f"forces predicted by the {scene.held.prediction} predictor"
    )
    others = "; ".join(each.name for each in among if each is not setting)
    rate_Hz = 1e3 / scene.held.coupling.model_ms
    return (
        f"renderer {scene.held.renderer}, {predictor}, tissue asked at {rate_Hz:g} Hz "
        f"({setting.name!r}, rather than "
        f"{others}), the tissue itself as the scene has it"
    )
