"""The cheapest setting that is good enough: model no more than a scene needs."""

from collections.abc import Sequence

from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from tissue.evaluation.charts.error_bounds import BOUND_FAMILIES
from tissue.evaluation.charts.frontier import frontier_of
from tissue.evaluation.charts.law_choice import with_law
from tissue.evaluation.charts.measure import Measured
from tissue.evaluation.charts.reference import reference_words
from tissue.evaluation.charts.settings import Setting
from tissue.scene.coupling import Fidelity
from tissue.scene.load import changed
from tissue.scene.scene import Scene

__all__ = ["SAFETY", "choose", "with_fidelity"]

SAFETY = 1.5
"""How far below a demanded error a setting has to stay at the places it was measured at, so that it holds elsewhere.

Set on seeds 1-10 of an earlier force law. On five motions that set nothing of each of four scenes and of four imaged
teeth and scapulae every demand is kept; with 1.25 all but one tooth's are, with 1 a demand of 1 % is kept by two
motions in five on another (tests/bench/held_out.py).
"""


def choose(points: Sequence[Measured], wanted: Fidelity, *, gap: float = 0.0) -> Measured:
    """The cheapest of some measurements that meets a demand; no error counts as less than the reference's own, `gap`.

    What is no setting, a law that no tick can run or the rounding of numbers, is passed over.

    Raises
    ------
    InputError
        If none does; the sentence names the nearest that can.
    """

    points = [point for point in points if point.family not in BOUND_FAMILIES]

    def error_of(point: Measured) -> float:
        return max(SAFETY * point.force_error, gap)

    fits = [
        point
        for point in points
        if (wanted.force_error is None or error_of(point) <= wanted.force_error)
        and (wanted.tick_ms is None or 1e-3 * point.p99_us <= wanted.tick_ms)
    ]
    if fits:
        cheap = wanted.force_error is not None
        return min(fits, key=lambda point: point.median_us if cheap else point.force_error)

    def short_of(point: Measured) -> float:
        error = 0.0 if wanted.force_error is None else error_of(point) / wanted.force_error
        tick = 0.0 if wanted.tick_ms is None else 1e-3 * point.p99_us / wanted.tick_ms
        return max(error, tick)

    nearest = min(points, key=short_of)
    raise InputError(
        f"fidelity must be met by a setting of {nearest.scene} on this machine, got {_asked(wanted)}: the nearest is "
        f"{nearest.setting} with force_error = {error_of(nearest):.2g} and tick_ms = "
        f"{1e-3 * nearest.p99_us:.2g}"
    )


def with_fidelity(scene: Scene, *, report: Progress = silent) -> tuple[Scene, str]:
    """A scene at the cheapest setting that meets its `fidelity`, and what was chosen and why.

    The settings of the scene are measured first where that was not done on this machine.

    Raises
    ------
    InputError
        If no setting meets it.
    """
    wanted = scene.fidelity
    if wanted is None:
        return scene, "as it is: no fidelity was asked for"
    plain = changed(scene, {"fidelity": None})
    found = frontier_of(plain, report=report)
    point = choose(found.points, wanted, gap=found.gap)
    setting = next(each for each in found.settings if each.name == point.setting)
    at, law = with_law(changed(plain, setting.changes), wanted)
    sentence = (
        f"{_in_words(at, setting, found.settings)}: force {100.0 * point.force_error:.2g} % over ticks, "
        f"{100.0 * point.error_50_ms:.2g} % over 50 ms, from {reference_words(scene, found.gap)}; "
        f"tick {point.median_us:.0f} µs, 99 % {point.p99_us:.0f} µs, "
        + ("the cheapest" if wanted.force_error is not None else "the most accurate")
        + f" of {len(found.points)} settings that meets {_asked(wanted)}{law}"
    )
    leaves_out = [f"{point.leaves_out}, which no force needs"] if point.leaves_out else []
    late_ms = 0 if at.device is None else at.device.coupling.delay_ms + at.device.coupling.model_ms - 1
    if at.device is not None and at.device.prediction in ("none", "hold") and late_ms > 0:
        leaves_out.append(f"prediction, so that the force comes up to {late_ms} ms late")
    if leaves_out:
        sentence += f"; leaves out {'; and '.join(leaves_out)}"
    return at, sentence


def _asked(wanted: Fidelity) -> str:
    """A demand as it was written."""
    return ", ".join(f"{name} = {value:g}" for name, value in wanted if value is not None)


def _in_words(scene: Scene, setting: Setting, among: Sequence[Setting]) -> str:
    """What a scene is at a setting, and of which it was chosen."""
    if scene.device is None:
        return f"{setting.name}, of {'; '.join(each.name for each in among)}"
    foresight = {"none": "no prediction", "hold": "the tissue's last force held"}
    predictor = foresight.get(scene.held.prediction, f"forces foretold by the {scene.held.prediction} predictor")
    others, rate = "; ".join(each.name for each in among if each is not setting), 1e3 / scene.held.coupling.model_ms
    return (
        f"renderer {scene.held.renderer}, {predictor}, tissue asked at {rate:g} Hz ({setting.name!r}, "
        f"rather than {others}), the tissue itself as the scene has it"
    )
