"""Tables of parts that accept parts from outside the package.

These are devices, hands, renderers, predictors and perceptual maps.
"""

from pathlib import Path

import numpy as np
import pytest

from tissue import InputError, Scene, load_scene, simulate
from tissue.cli.calibrate import calibrate
from tissue.cli.study import run
from tissue.evaluation.charts.prediction import (
    Interval,
    PredictorComparison,
    comparison_lines,
    draw_tasks,
)
from tissue.evaluation.training import HORIZONS
from tissue.materials.constants import listed
from tissue.scene.named_parts import Registry
from tissue.scene.registry import (
    CUTTING_MATERIALS,
    DEVICES,
    GROUPS,
    HANDS,
    PERCEPTIONS,
    PREDICTORS,
    RENDERERS,
    SCENES,
    TABLES,
    DeviceEntry,
    PredictorEntry,
)


def run_of(**changes):
    """A short run of a ball that a hand presses on a wall."""
    given = {"device": "touch", "duration_s": 0.6, "coupling.stiffness_N_m": 300.0}
    return simulate(
        load_scene(
            "wall", given | {key.replace("__", "."): value for key, value in changes.items()}
        )
    )


def force_N(run):
    """Force across the wall over time."""
    return np.abs(run.trace["device_force_z_N"])


def test_a_table_loads_lists_and_refuses():
    table = Registry("renderer", {"proxy": dict})
    assert (
        list(table) == ["proxy"]
        and len(table) == 1
        and "proxy" in table
        and callable(table["proxy"])
    )
    with pytest.raises(
        InputError,
        match=r"^renderer must be one of proxy, got prox \(did you mean proxy\?\): choose one",
    ):
        table["prox"]
    with pytest.raises(
        InputError,
        match=r"^name must be none of proxy, got proxy: choose another name for this renderer$",
    ):
        table.add("proxy", dict)
    table.remove("proxy")
    assert table.names == ()
    with pytest.raises(InputError, match=r"^renderer must be one of"):
        table.remove("proxy")


def test_a_device_from_outside_is_held(added):
    """A device from outside is held.

    It has 0.2 N and a third of the mass. It plays no torque, so that a stiffness of turns has no
    effect.
    """
    added(
        DEVICES,
        "feather",
        DeviceEntry(
            {
                "mass_kg": 0.03,
                "damping_N_s_m": 0.2,
                "force_limit_N": 0.2,
                "stiffness_limit_N_m": 400.0,
            }
        ),
    )
    weak, strong = run_of(device="feather"), run_of(device="touch")
    assert 0.19 < force_N(weak).max() <= 0.2 and force_N(strong).max() > 0.5
    with pytest.raises(
        InputError,
        match=(
            r"device.kind must be one of touch, omni, six-dof, haply, forcedimension, sigma-7, "
            r"openhaptics, network, recorded, feather, got fether \(did"
        ),
    ):
        load_scene("wall", {"device": "fether"})
    with pytest.raises(
        InputError,
        match=r"stiffness_Nm_rad must be left out with a device that plays no torque, got 0.3",
    ):
        load_scene("wall", {"device": "feather", "coupling.stiffness_Nm_rad": 0.3})


def test_a_hand_from_outside_holds(added):
    added(HANDS, "limp", HANDS["expert"] | {"stiffness_N_m": 30.0})
    limp, firm = run_of(hand="limp"), run_of(hand="expert")
    assert force_N(limp).max() < 0.5 * force_N(firm).max()
    with pytest.raises(
        InputError,
        match=r"hand must be one of novice, intermediate, expert, limp, got lim \(did you",
    ):
        load_scene("wall", {"hand": "lim"})


class Half:
    """A spring of half the stiffness that it was given."""

    def __init__(self, loop):
        self.stiffness_N_m = 0.5 * loop.stiffness_N_m

    def render(self, device, device_velocity, proxy, proxy_velocity, dt):
        return self.stiffness_N_m * (proxy - device)

    def pause(self):
        pass


def test_a_renderer_from_outside_plays(added):
    added(RENDERERS, "half", Half)
    soft, stiff = run_of(renderer="half"), run_of(renderer="penalty")
    assert force_N(soft).max() > 0.05
    assert not np.array_equal(force_N(soft), force_N(stiff))
    with pytest.raises(
        InputError,
        match=r"renderer must be one of penalty, passivity, proxy, half, got halv \(did you",
    ):
        load_scene("wall", {"renderer": "halv"})
    assert (
        Scene.model_json_schema()["$defs"]["Device"]["properties"]["renderer"]["enum"][-1] == "half"
    )


class Third:
    """Expects a third of the last force at any time ahead."""

    residual_N, is_primary = 0.0, True

    def __init__(self):
        self.force_N = np.zeros(3)

    def observe(self, position_m, velocity_m_s, force_N):
        self.force_N = self.force_N if force_N is None else force_N.copy()

    def predict(self, ticks):
        return self.force_N / 3.0 if ticks else self.force_N

    def pause(self):
        pass


def test_a_predictor_from_outside_predicts_and_is_charted(added, tmp_path):
    added(
        PREDICTORS,
        "third",
        PredictorEntry(lambda trained, force_limit_N: Third(), colour="0.2", marker="h"),
    )
    third, held = run_of(prediction="third"), run_of(prediction="hold")
    assert force_N(third).max() < 0.8 * force_N(held).max()
    with pytest.raises(
        InputError,
        match=(
            r"prediction must be one of none, hold, .*, koopman-look-ahead, third, got thirt "
            r"\(did you"
        ),
    ):
        load_scene("wall", {"prediction": "thirt"})
    with pytest.raises(
        InputError,
        match=r"coupling.predictor_file must be left out unless a trained prediction is used",
    ):
        load_scene("wall", {"prediction": "third", "coupling.predictor_file": "mine.npz"})
    errors = {
        kind: np.linspace(0.1, 0.2, 8)[:, None] * np.ones(len(HORIZONS)) for kind in PREDICTORS
    }
    costs, nothing = dict.fromkeys(PREDICTORS, (1.0, 2.0)), Interval(0.0, 0.0, 0.0)
    found = PredictorComparison("wall", errors, costs, np.array([1.0 + 0j]), {1: nothing}, {})
    assert any("third" in line for line in comparison_lines([found]))
    draw_tasks([found], tmp_path / "tasks.png")
    assert (tmp_path / "tasks.png").stat().st_size > 1000


class Share:
    """Makes felt so much of every force."""

    steepest, above, estimated_N, perceived, perceived_spread = 1.0, False, 0.0, 0.0, 0.0

    def __init__(self, argument, *, rng, force_limit_N, tick_s, friction_N):
        assert force_limit_N == pytest.approx(3.3) and tick_s == pytest.approx(1e-3)
        self.share, self.sentence = float(argument), f"felt by a share of {argument}"

    def step(self, force_N):
        return self.share * force_N

    def pause(self):
        pass


def test_a_perceptual_map_from_outside_scales(added):
    added(PERCEPTIONS, "share:NUMBER", Share)
    quarter, whole = run_of(perception="share:0.25"), run_of(perception="share:1")
    assert force_N(quarter).max() < 0.5 * force_N(whole).max()
    for refused in ("share:", "share", "shares:1"):
        with pytest.raises(
            InputError,
            match=(
                r"^device.perception must be one of none, population, observer:FILE, "
                r"share:NUMBER, got share"
            ),
        ):
            load_scene("wall", {"perception": refused})
    pattern = Scene.model_json_schema()["$defs"]["Device"]["properties"]["perception"]["pattern"]
    assert pattern == "^(none|population|observer:.+|share:.+)$"


def test_a_part_that_was_removed_is_refused():
    with pytest.raises(
        InputError,
        match="renderer must be one of penalty, passivity, proxy, got half: choose one of",
    ):
        load_scene("wall", {"device": "touch", "renderer": "half"})


def test_the_page_and_the_help_texts_list_every_name():
    page = (Path(__file__).parents[3] / "docs" / "commands.md").read_text("utf-8")
    assert CUTTING_MATERIALS.known == listed("cutting")
    for table in {
        id(table): table for each in TABLES.values() for table in each if table is not SCENES
    }.values():
        row = f"| `{table.key}` | {', '.join(f'`{name}`' for name in table)} |"
        assert row in page
    for name in (*DEVICES, *GROUPS):
        assert name in calibrate.__doc__
    for name in GROUPS:
        assert name in run.__doc__
