"""Predictions for the published set-ups: at the cited constants, over their ranges, after a fit.

Every set of measurements becomes a list of compared figures. A band is the 5 to 95 % quantiles over
the ranges of the cited constants, the geometry of the drill, and what the source does not state.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import drilling
import numpy as np
from published import DataSet, Figure, Row, data_sets
from scipy.optimize import nnls

from meshes.base.arrays import Array
from tissue.materials.constants import Prior, constants

__all__ = ["Compared", "FitResult", "Ratio", "compared", "fitted", "log_errors", "ratios"]

MERCHANT = np.arctan(160.0 / 250.0)
"""Friction angle at the cited chip coefficients; see `tissue.cutters.drill_point`."""
SAW_WIDTH_MM = 0.64
FOAM_KG_M3 = 252.0
RATIO_KG_M3 = 1800.0
"""Density for ratios, which do not depend on it."""


@dataclass(frozen=True)
class Compared:
    """Measured figure with its prediction.

    Attributes
    ----------
    label
        Figure, such as ``thrust at 1000 rpm, 120 mm/min / N``.
    kind
        ``thrust``, ``torque`` or the kind of the figure.
    measured, low, high
        Measured value and the ends of its scatter; None without one.
    predicted
        Prediction at the cited constants.
    band
        Ends of the 90 % band over the ranges.
    """

    label: str
    kind: str
    measured: float
    low: float | None
    high: float | None
    predicted: float
    band: tuple[float, float]

    @property
    def inside(self) -> bool:
        """True if the band contains the measured value."""
        return self.band[0] <= self.measured <= self.band[1]

    @property
    def error(self) -> float:
        """Relative error of the prediction at the cited constants."""
        return self.predicted / self.measured - 1.0

    @property
    def noise(self) -> float | None:
        """Half the measured scatter over the measured value; None without scatter."""
        if self.low is None or self.high is None:
            return None
        return 0.5 * (self.high - self.low) / self.measured


@dataclass(frozen=True)
class Drawn:
    """Law, drill and unknown quantities of a set: nominal (one sample) or sampled."""

    law: drilling.Law
    point: drilling.Point
    unknown: dict[str, Array]
    z: Array | None = None


@cache
def _samples() -> tuple[Array, drilling.Law, drilling.Point]:
    z = drilling.standard(4)
    return z, drilling.sampled_law(z), drilling.sampled_points(z)


def nominal(data: DataSet, name: str = drilling.DEFAULT) -> Drawn:
    """Return law, drill and unknown quantities at their cited or assumed values."""
    law, point = drilling.variant(name)
    unknown = {key: np.array([each.value]) for key, each in data.unknown.items()}
    return Drawn(law, point, unknown)


def sampled(data: DataSet) -> Drawn:
    """Return samples of law, drill and unknown quantities."""
    z, law, point = _samples()
    first = len(drilling.COLUMNS)
    unknown = {
        key: each.prior.x(z[:, first + at]) for at, (key, each) in enumerate(data.unknown.items())
    }
    return Drawn(law, point, unknown, z)


def row_loads(data: DataSet, row: Row, drawn: Drawn) -> drilling.Loads:
    """Return the loads of a row's drill."""
    unknown = drawn.unknown
    feed = unknown.get("feed_per_turn_mm")
    if feed is None:
        rpm = unknown["rpm"] if row.rpm is None else row.rpm
        feed = (unknown["feed_mm_min"] if row.feed_mm_min is None else row.feed_mm_min) / rpm
    diameter = unknown["diameter_mm"] if data.diameter_mm is None else data.diameter_mm
    return drilling.drill_loads(
        drawn.law,
        drawn.point,
        diameter_mm=diameter,
        feed_per_turn_mm=feed,
        density_kg_m3=unknown.get("density_kg_m3", np.array([RATIO_KG_M3])),
    )


def measured_of(row: Row) -> list[tuple[str, str, float, float | None]]:
    """Return quantity, unit, measured value and scatter of each measured load of a row."""
    both = (
        ("thrust", "N", row.thrust_N, row.thrust_scatter_N),
        ("torque", "Nmm", row.torque_Nmm, row.torque_scatter_Nmm),
    )
    return [(name, unit, value, pm) for name, unit, value, pm in both if value is not None]


def _condition(row: Row) -> str:
    parts = []
    if row.rpm is not None:
        parts.append(f"{row.rpm:g} rpm")
    if row.feed_mm_min is not None:
        parts.append(f"{row.feed_mm_min:g} mm/min")
    return ", ".join(parts) or "speed and feed not stated"


def _of_rows(data: DataSet) -> list[Compared]:
    centre = nominal(data)
    spread = sampled(data)
    found = []
    for row in data.rows:
        at_centre = row_loads(data, row, centre)
        over = row_loads(data, row, spread)
        for quantity, unit, value, pm in measured_of(row):
            name = f"{quantity}_{unit}"
            found.append(
                Compared(
                    f"{quantity}, {_condition(row)} / {unit}",
                    quantity,
                    value,
                    None if pm is None else value - pm,
                    None if pm is None else value + pm,
                    float(getattr(at_centre, name)[0]),
                    _ends(getattr(over, name)),
                )
            )
    return found


def _ends(values: Array) -> tuple[float, float]:
    low, high = np.quantile(values, [0.05, 0.95]).tolist()
    return low, high


Formula = Callable[[DataSet, Figure, Drawn], Array]


def feed_ratio(data: DataSet, figure: Figure, drawn: Drawn) -> Array:
    """Thrust at six times the feed over the thrust at 30 mm/min."""
    thrusts = [
        row_loads(data, Row("test", feed_mm_min=feed), drawn).thrust_N for feed in (180.0, 30.0)
    ]
    return np.asarray(thrusts[0] / thrusts[1])


def split_ratio(data: DataSet, figure: Figure, drawn: Drawn) -> Array:
    """Thrust of a drill with a split point over that of a usual drill."""
    share = drawn.unknown["split_web_share"]
    if drawn.z is None:
        split = drilling.point_of(float(share[0]), 36.0, 118.0)
    else:
        split = drilling.sampled_points(drawn.z, web_share=share)
    row = Row("test")
    usual = row_loads(data, row, drawn).thrust_N
    return np.asarray(row_loads(data, row, Drawn(drawn.law, split, drawn.unknown)).thrust_N / usual)


def saw(data: DataSet, figure: Figure, drawn: Drawn) -> Array:
    """Forces of a saw tooth with a straight edge."""

    def forces(depth_um: float) -> tuple[Array, Array]:
        law = drawn.law
        size = len(law["radial_chip_N_mm2"])
        chip, edge = law.chip_and_edge(np.full(size, 1e-3 * depth_um))
        cutting = law["tangential_chip_N_mm2"] * chip + law["tangential_edge_N_mm"] * edge
        thrust = law["radial_chip_N_mm2"] * chip + law["radial_edge_N_mm"] * edge
        return SAW_WIDTH_MM * cutting, SAW_WIDTH_MM * thrust

    if figure.kind == "resultant":
        assert figure.depth_um is not None
        return np.hypot(*forces(figure.depth_um))
    if figure.kind == "thrust over cutting":
        assert figure.depth_um is not None
        cutting, thrust = forces(figure.depth_um)
        return np.asarray(thrust / cutting)
    place = 1 if figure.kind == "thrust growth" else 0
    return np.asarray(forces(10.0)[place] / forces(2.0)[place])


def rake(data: DataSet, figure: Figure, drawn: Drawn) -> Array:
    """Cutting energy at a rake of 45 over that at 23 degrees, by Merchant's formula."""
    law = drawn.law
    thickness = np.broadcast_to(1e-3 * drawn.unknown["chip_um"], law["radial_chip_N_mm2"].shape)
    chip, edge = law.chip_and_edge(thickness)
    forces = []
    for angle_deg in (45.0, 23.0):
        factor = _merchant(angle_deg) / _merchant(0.0)
        forces.append(
            law["tangential_chip_N_mm2"] * chip * factor + law["tangential_edge_N_mm"] * edge
        )
    return np.asarray(forces[0] / forces[1])


def _merchant(rake_deg: float) -> float:
    angle = MERCHANT - np.radians(rake_deg)
    return float(np.cos(angle) / (1.0 - np.sin(angle)))


def foam(data: DataSet, figure: Figure, drawn: Drawn) -> Array:
    """Strength of foam over that of cancellous bone, by the density exponent of bone."""
    ratio = FOAM_KG_M3 / drawn.unknown["bone_density_kg_m3"]
    return np.asarray(ratio ** drawn.law["density_exponent"])


def dental(data: DataSet, figure: Figure, drawn: Drawn) -> Array:
    """Tangential over normal force of an enamel edge."""
    enamel = constants("cutting", "enamel")
    parts = {}
    for at, name in enumerate(
        f"{side}_{part}"
        for side in ("tangential", "radial")
        for part in ("chip_N_mm2", "edge_N_mm")
    ):
        if drawn.z is None:
            parts[name] = np.array([enamel[name].value])
        else:
            # The columns of bone stand in: the set uses no constant of bone.
            parts[name] = Prior.of(enamel[name], name).x(drawn.z[:, at])
    chip_mm = 1e-6 * drawn.unknown["chip_nm"]
    share = np.minimum(chip_mm / (1e-3 * enamel["minimum_chip_um"].value), 1.0)
    tangential = parts["tangential_chip_N_mm2"] * chip_mm + parts["tangential_edge_N_mm"] * share
    normal = parts["radial_chip_N_mm2"] * chip_mm + parts["radial_edge_N_mm"] * share
    return np.asarray(tangential / normal)


def ligament(data: DataSet, figure: Figure, drawn: Drawn) -> Array:
    """Modulus of the ligament [MPa]; it does not change with the load."""
    cited = constants("tooth", "ligament")["modulus_GPa"]
    if figure.kind == "stiffening":
        return np.ones(1 if drawn.z is None else len(drawn.z))
    if drawn.z is None:
        return np.array([1e3 * cited.value])
    return 1e3 * Prior.of(cited, "modulus_GPa").x(drawn.z[:, 0])


def molar(data: DataSet, figure: Figure, drawn: Drawn) -> Array:
    """Force [N] in the scene ``molar``: cited value, or the two ends of its band.

    The quantiles of two equal halves of samples are those ends.
    """
    from engine_runs import molar_figures

    cited, low, high = molar_figures()[figure.kind]
    return np.array([cited]) if drawn.z is None else np.repeat([low, high], 100)


def reamed(data: DataSet, figure: Figure, drawn: Drawn) -> Array:
    """Error of a reamed surface [mm]: measured on the engine's voxels, the same in every sample."""
    from engine_runs import reamed_error_mm

    return np.array([reamed_error_mm(data.law)])


FORMULAS: dict[str, Formula] = {
    "drill ratio": feed_ratio,
    "chisel": split_ratio,
    "saw": saw,
    "rake": rake,
    "foam": foam,
    "dental ratio": dental,
    "ligament": ligament,
    "molar": molar,
    "reamed diameter": reamed,
    "reamed sphere": reamed,
}


@cache
def compared(key: str) -> tuple[Compared, ...]:
    """Return the compared figures of a data set."""
    data = data_sets()[key]
    if data.law == "drill":
        return tuple(_of_rows(data))
    formula = FORMULAS[data.law]
    spread = sampled(data)
    found = []
    for figure in data.figures:
        found.append(
            Compared(
                figure.name,
                figure.kind,
                figure.value,
                figure.low,
                figure.high,
                float(formula(data, figure, nominal(data))[0]),
                _ends(formula(data, figure, spread)),
            )
        )
    return tuple(found)


@dataclass(frozen=True)
class Ratio:
    """Measured and predicted ratio of two rows.

    ``kind`` is ``speed``, ``feed`` or ``both``, after the quantity that differs between the rows,
    or ``torque over thrust`` for two loads of one row [mm].
    """

    label: str
    kind: str
    quantity: str
    measured: float
    noise: float | None
    predicted: float

    @property
    def error(self) -> float:
        """Relative error of the predicted ratio."""
        return self.predicted / self.measured - 1.0


def ratios(key: str, variant: str = drilling.DEFAULT) -> list[Ratio]:
    """Return the ratios of a data set's loads to its row of lowest speed or feed."""
    data = data_sets()[key]
    if data.law == "drill ratio":
        (figure,) = data.figures
        value = float(feed_ratio(data, figure, nominal(data, variant))[0])
        return [Ratio(figure.name, "feed", "thrust", figure.value, None, value)]
    if data.law != "drill":
        return []
    drawn = nominal(data, variant)
    found = []
    for kind, row, base in _pairs(data.rows):
        loads = [row_loads(data, each, drawn) for each in (row, base)]
        for at, (quantity, unit, value, pm) in enumerate(measured_of(row)):
            _, _, base_value, base_pm = measured_of(base)[at]
            predicted = [float(getattr(each, f"{quantity}_{unit}")[0]) for each in loads]
            noise = None
            if pm is not None and base_pm is not None and data.specimens is not None:
                noise = float(np.hypot(pm / value, base_pm / base_value) / data.specimens**0.5)
            found.append(
                Ratio(
                    f"{quantity}, {_condition(row)} over {_condition(base)}",
                    kind,
                    quantity,
                    value / base_value,
                    noise,
                    predicted[0] / predicted[1],
                )
            )
    return found + _arms(data, drawn)


def _arms(data: DataSet, drawn: Drawn) -> list[Ratio]:
    """Return torque over thrust [mm] of rows that have both."""
    found = []
    for row in data.rows:
        if row.torque_Nmm is None or row.thrust_N is None:
            continue
        loads = row_loads(data, row, drawn)
        arm = float(loads.torque_Nmm[0] / loads.thrust_N[0])
        measured = row.torque_Nmm / row.thrust_N
        label = f"torque over thrust, {_condition(row)} / mm"
        found.append(Ratio(label, "torque over thrust", "both", measured, None, arm))
    return found


def _pairs(rows: tuple[Row, ...]) -> list[tuple[str, Row, Row]]:
    """Return kind, row and base of every ratio."""
    found = []
    for feed in dict.fromkeys(row.feed_mm_min for row in rows):
        alike = sorted((r for r in rows if r.feed_mm_min == feed), key=lambda r: r.rpm or 0.0)
        if alike[0].rpm is not None:
            found += [("speed", row, alike[0]) for row in alike[1:]]
    for rpm in dict.fromkeys(row.rpm for row in rows):
        alike = sorted((r for r in rows if r.rpm == rpm), key=lambda r: r.feed_mm_min or 0.0)
        if alike[0].feed_mm_min is not None:
            found += [("feed", row, alike[0]) for row in alike[1:]]
    if not found and len(rows) == 2 and rows[0].rpm is not None:
        found = [("both", rows[1], rows[0])]
    return found


def log_errors(key: str, variant: str = drilling.DEFAULT) -> Array:
    """Return logarithms of predicted over measured loads of a drilling set, shape (n,)."""
    data = data_sets()[key]
    drawn = nominal(data, variant)
    found = []
    for row in data.rows:
        loads = row_loads(data, row, drawn)
        for quantity, unit, value, _ in measured_of(row):
            found.append(np.log(float(getattr(loads, f"{quantity}_{unit}")[0]) / value))
    return np.array(found)


@dataclass(frozen=True)
class FitResult:
    """Factors fitted to one half of a set's rows and the errors on the other half.

    Attributes
    ----------
    chip, edge
        Factors of chip and edge coefficients; equal if one factor was fitted.
    fit_error, test_error
        Root mean square of the relative errors on both halves.
    """

    chip: float
    edge: float
    fit_error: float
    test_error: float


def fitted(key: str, factors: int, variant: str = drilling.DEFAULT) -> FitResult | None:
    """Fit one or two factors to the half of a set's rows; None if the set has too few rows.

    The relative errors are minimised by least squares. Two factors are at least 0.
    """
    data = data_sets()[key]
    if data.law != "drill":
        return None
    drawn = nominal(data, variant)
    parts: dict[str, list[list[float]]] = {"fit": [], "test": []}
    for row in data.rows:
        loads = row_loads(data, row, drawn)
        for quantity, _, value, _ in measured_of(row):
            chip = float(getattr(loads, f"{quantity}_chip")[0]) / value
            edge = float(getattr(loads, f"{quantity}_edge")[0]) / value
            parts[row.half].append([chip, edge])
    if not parts["fit"] or not parts["test"]:
        return None
    matrix = np.array(parts["fit"])
    if len(matrix) < factors:
        return None
    if factors == 1:
        matrix = matrix.sum(axis=1, keepdims=True)
    found = nnls(matrix, np.ones(len(matrix)))[0]
    chip, edge = float(found[0]), float(found[-1])
    errors = {
        half: float(np.sqrt(np.mean((np.array(each) @ [chip, edge] - 1.0) ** 2)))
        for half, each in parts.items()
    }
    return FitResult(chip, edge, errors["fit"], errors["test"])
