"""`tissue.register`: a user's own parts.

Scenes name them; they are listed, judged and charted, or refused in a sentence.
"""

import json
from functools import partial
from typing import Literal

import numpy as np
import pytest
from outside_tissue import CHANGES, Jelly, jelly
from pydantic import model_validator

from tissue import InputError, load_scene, register, simulate
from tissue.cutters.profile import cylinder
from tissue.evaluation import stability_report
from tissue.evaluation.charts.prediction import (
    PredictorComparison,
    comparison_lines,
    draw_tasks,
    looks,
)
from tissue.evaluation.stability_report import scene_stability
from tissue.evaluation.training import HORIZONS
from tissue.haptics.device.device import DeviceParameters, Sample
from tissue.motion.motion import Motion
from tissue.objects.part_checks import checked_numbers
from tissue.prediction.guard import Guarded
from tissue.scene.anatomy import Part
from tissue.scene.registry import PREDICTORS
from tissue.scene.texts import schema_text
from tissue.scene.tool import Probe

LIGHT = {"mass_kg": 0.03, "damping_N_s_m": 0.2, "force_limit_N": 1.0}


def test_numbers_of_numpy_are_numbers():
    given = {"mass_kg": np.float32(0.25), "damping_N_s_m": np.int64(1)}
    assert checked_numbers(DeviceParameters, given) == {"mass_kg": 0.25, "damping_N_s_m": 1.0}


def run_of(**changes):
    """A short run of a ball that a hand presses on a wall."""
    given = {"device": "touch", "duration_s": 0.6, "coupling.stiffness_N_m": 300.0}
    return simulate(
        load_scene(
            "wall", given | {key.replace("__", "."): value for key, value in changes.items()}
        )
    )


class Drift:
    """Predictor that continues along the last change of the force."""

    def __init__(self):
        self.force_N, self.change_N = np.zeros((2, 3))

    def observe(self, position_m, velocity_m_s, force_N):
        if force_N is not None:
            self.change_N, self.force_N = force_N - self.force_N, force_N

    def predict(self, ticks):
        return self.force_N + 0.5 * min(ticks, 4.0) * self.change_N


def test_a_predictor_of_two_methods_runs_guarded_is_judged_and_charted(tmp_path):
    register.predictor("drift", Drift)
    run = run_of(prediction="drift", coupling__delay_ms=4)
    predictor = run.parts.motion.predictor
    assert isinstance(predictor, Guarded) and isinstance(predictor.inner.inner, Drift)
    assert (
        run.trace["prediction_residual_N"].max() > 0.0
        and 0.0 < run.trace["predicted_by"].mean() <= 1.0
    )
    assert "prediction" in run.parts.notes
    errors = {
        kind: np.linspace(0.1, 0.2, 8)[:, None] * np.ones(len(HORIZONS)) for kind in PREDICTORS
    }
    costs = dict.fromkeys(PREDICTORS, (1.0, 2.0))
    found = PredictorComparison("wall", errors, costs)
    assert "with its guard (arithmetic mean over the runs" in comparison_lines([found])[0]
    assert any("drift" in line for line in comparison_lines([found]))
    assert any(" drift: 1.00 times the error of hold" in line for line in comparison_lines([found]))
    draw_tasks([found], tmp_path / "tasks.png")
    register.predictor("drift-2", Drift)
    seen = looks()
    assert len(set(seen.values())) == len(seen)
    for name in ("drift", "drift-2"):
        others = [look for kind, look in seen.items() if kind != name]
        assert seen[name][0] not in [colour for colour, _ in others]
        assert seen[name][1] not in ["*", *(mark for _, mark in others)]
    with pytest.raises(InputError, match="did you mean drift"):
        load_scene("wall", {"prediction": "drif"})
    assert (
        "drift" in json.loads(schema_text())["$defs"]["Device"]["properties"]["prediction"]["enum"]
    )


@pytest.mark.slow
def test_a_predictor_that_over_compensates_is_refused_by_the_judge_of_stability(monkeypatch):
    small = partial(stability_report.stability_map, rows=4, columns=7)
    monkeypatch.setattr(stability_report, "stability_map", small)

    @register.predictor("eager")
    class Eager(Drift):
        def predict(self, ticks):
            return 3.0 * self.force_N if ticks else self.force_N

    assert Eager.__name__ == "Eager"
    changes = {"device": "touch", "prediction": "eager", "coupling.delay_ms": 4}
    calm, eager = (
        scene_stability(load_scene("wall", changes | {"prediction": kind})).verdict.critical_N_m
        for kind in ("hold", "eager")
    )
    assert eager < 0.5 * calm
    with pytest.raises(InputError, match=r"coupling.stiffness_N_m"):
        simulate(load_scene("wall", changes | {"coupling.stiffness_N_m": 0.9 * calm}))


def test_a_predictor_that_never_forgets_or_returns_other_shapes_is_refused():
    @register.predictor("sum")
    class Sum(Drift):
        def observe(self, position_m, velocity_m_s, force_N):
            self.force_N = self.force_N + (0.0 if force_N is None else force_N)

    @register.predictor("flat")
    class Flat(Drift):
        def predict(self, ticks):
            return 0.0

    @register.predictor("growing")
    class Growing(Drift):
        def predict(self, ticks):
            self.force_N = 1.5 * self.force_N
            return self.force_N

    @register.predictor("undefined")
    class Undefined(Drift):
        def predict(self, ticks):
            return np.nan * self.force_N

    with pytest.raises(InputError, match=r"predictor sum must .* 512 ticks"):
        run_of(prediction="sum")
    with pytest.raises(InputError, match="predictor growing must return the same force in two"):
        run_of(prediction="growing")
    with pytest.raises(InputError, match="predictor undefined must return finite forces"):
        run_of(prediction="undefined")
    with pytest.raises(InputError, match="predictor flat"):
        run_of(prediction="flat")


class Sprung:
    """A handle on a spring that a recorded push presses onto the wall and into it."""

    opened = 0

    def __init__(self, start_m):
        type(self).opened += 1
        self.start_m, self.commands = start_m, []

    def read(self, time_s):
        x, y, z = self.start_m
        return Sample(time_s, (x, y, z - 0.025 * min(time_s / 0.3, 1.0)))

    def command(self, force_N, torque_Nm):
        self.commands.append(force_N)


def test_a_device_is_opened_where_a_scene_names_it(command, here):
    opens = register.device("sprung", DeviceParameters(**LIGHT))
    simulate(
        load_scene("wall", {"device": "sprung", "prediction": "linear", "duration_s": 0.01})
    )  # no limit of stiffness
    simulated = run_of(device="sprung")
    assert type(simulated.parts.motion.device).__name__ == "SimulatedDevice"
    assert opens(Sprung) is Sprung
    run = run_of(device="sprung", duration_s=0.4)
    device = run.parts.motion.device
    assert (
        isinstance(device, Sprung)
        and len(device.commands) >= 400
        and not np.any(device.commands[-1])
    )
    assert max(np.abs(force).max() for force in device.commands) > 0.2
    assert "sprung checked for the hand of" in run.parts.notes["coupling"]
    opened = Sprung.opened
    words = ("run", "wall", "--set", "device=sprung", "--no-pictures", "--out", "out")
    code, output, error = command(*words, "--duration-s", 0.1)
    assert (code, error) == (0, "") and "sprung" in output and Sprung.opened == opened + 1
    with pytest.raises(
        InputError, match=r"device.kind must be one of touch, .* or sprung, got spring"
    ):
        load_scene("wall", {"device": "spring"})


def test_hand_renderer_and_perception():
    register.hand("limp", {"stiffness_N_m": 30.0})

    @register.renderer("half")
    class Half:
        def __init__(self, loop):
            self.stiffness_N_m = 0.5 * loop.stiffness_N_m

        def render(self, device, device_velocity, proxy, proxy_velocity, dt):
            return self.stiffness_N_m * (proxy - device)

        def pause(self):
            pass

    @register.perception("share:NUMBER")
    class Share:
        steepest, above, estimated_N, perceived, perceived_spread = 1.0, False, 0.0, 0.0, 0.0

        def __init__(self, argument, *, rng, force_limit_N, tick_s, friction_N):
            self.share, self.sentence = float(argument), f"a share of {argument}"

        def step(self, force_N):
            return self.share * force_N

        def pause(self):
            pass

    peak = lambda run: np.abs(run.trace["device_force_z_N"]).max()  # noqa: E731
    run = run_of(hand="limp", renderer="half", perception="share:0.5")
    assert 0.0 < peak(run) < 0.7 * peak(run_of(hand="limp", renderer="half"))


class Dip(Part):
    """Straight down."""

    kind: Literal["dip"] = "dip"


class Dipping(Motion):
    """A dip of 0.1 s."""

    duration_s = 0.1

    def __init__(self, dip, step_s):
        pass

    def sweep_m(self):
        return np.array([[0.0, 0.0, 1e-3], [0.0, 0.0, -1e-3]])

    def rotations(self):
        return np.stack([np.eye(3)] * 2)

    def begin(self, motion):
        motion.tip_m[:], motion.rotation[:], motion.heading[0] = (
            self.sweep_m()[0],
            np.eye(3),
            (0.0, 0.0, -1.0),
        )

    def advance(self, time_s, step_s, response, motion):
        motion.tip_m[2] = 1e-3 - 0.02 * time_s


def test_motion_and_tissue():
    register.motion("dip", Dip, Dipping)
    register.tissue("jelly", Jelly, jelly, tool=Probe, force_N=lambda scene: 40.0)
    run = simulate(load_scene("wall", {"device": "none", "motion.kind": "dip", "duration_s": None}))
    np.testing.assert_allclose(run.trace["tool_z_mm"], 1.0 - 20.0 * run.trace["time_s"], atol=1e-12)
    soft = simulate(load_scene("palpation", CHANGES))
    np.testing.assert_allclose(
        soft.trace["model_force_z_N"], 0.1 * soft.trace["depth_mm"], atol=1e-12
    )
    assert '"dip"' in schema_text() and '"jelly"' in schema_text()


class Slope(Part):
    """Motion whose validator raises an error of Python."""

    kind: Literal["slope"] = "slope"
    angle_deg: float = 0.0

    @model_validator(mode="after")
    def _angle_is_small(self):
        if self.angle_deg > 45.0:
            raise ValueError("angle_deg exceeds 45")
        return self


def test_an_error_of_a_parts_validator_is_passed_on():
    register.motion("slope", Slope, Dipping)
    with pytest.raises(InputError, match=r"^angle_deg exceeds 45$"):
        load_scene("wall", {"motion": {"kind": "slope", "angle_deg": 60.0}})


FOAM = "\n".join(
    (
        f'[cutting.foam.{name}]\nvalue = {value}\nrange = [0.0, 1000.0]\nsource = "made '
        'up"\nconfidence = "L"'
    )
    for name, value in {
        "tangential_chip_N_mm2": 15.0,
        "radial_chip_N_mm2": 6.0,
        "axial_chip_N_mm2": 0.0,
        "tangential_edge_N_mm": 0.5,
        "radial_edge_N_mm": 0.4,
        "axial_edge_N_mm": 0.0,
        "reference_density_kg_m3": 320.0,
        "density_exponent": 1.0,
    }.items()
)
GEL = "\n".join(
    (
        f"[soft.gel.{name}]\nvalue = {value}\nrange = [{0.9 * value}, {1.1 * value}]\nsource = "
        '"made up"\nconfidence = "L"'
    )
    for name, value in {"modulus_kPa": 20.0, "poisson_ratio": 0.45, "density_kg_m3": 1000.0}.items()
)


def test_a_material_is_cut_and_another_is_pressed(tmp_path):
    file = tmp_path / "materials.toml"
    file.write_text(f"{FOAM}\n{GEL}\n")
    assert register.material(file) == ("foam", "gel")
    changes = {"voxels.spacing_mm": 0.5, "duration_s": 0.2}
    bone, foam = (
        simulate(load_scene("milling", changes | {"cutting.material": each}))
        for each in ("bone", "foam")
    )
    peak = lambda run: np.linalg.norm(run.trace.vectors("model_force", "N"), axis=1).max()  # noqa: E731
    assert 0.0 < peak(foam) < 0.9 * peak(bone)
    assert "foam 0.015" in foam.parts.notes["specific cutting energy"]
    assert load_scene("palpation", {"organ.material": "gel"}).organ.material == "gel"
    for scene, key in (("milling", "cutting.material"), ("palpation", "organ.material")):
        with pytest.raises(InputError, match=rf"^{key} must be one of .*(foam|gel)"):
            load_scene(scene, {key: "clay"})


class Lacking:
    """Neither predicts nor renders."""

    def observe(self, position_m, velocity_m_s, force_N):
        pass


REFUSED = {
    "taken": (lambda: register.predictor("kalman", Drift), "kalman"),
    "of another tool": (lambda: register.tool("needle", cylinder), "needle"),
    "no name": (lambda: register.hand("My Hand", {}), "My Hand"),
    "no callable": (
        lambda: register.renderer("mine", 3),
        "renderer mine must be a class or a function, got 3",
    ),
    "no methods needed": (lambda: register.tool("mine", 5), "be a class or a function, got 5"),
    "methods": (
        lambda: register.predictor("mine", Lacking),
        "got Lacking without predict. Add predict$",
    ),
    "device methods": (lambda: register.device("mine", LIGHT, Lacking), "device mine .*read"),
    "motion": (lambda: register.motion("dip", Dip, Lacking), "motion dip .*sweep_m"),
    "kind": (lambda: register.motion("drop", Dip, Dipping), r'kind: Literal\["drop'),
    "no part": (lambda: register.motion("dip", Drift, Dipping), "parameters of the motion dip "),
    "number": (lambda: register.device("mine", LIGHT | {"mass": 1.0}), "mean mass_kg"),
    "numbers": (
        lambda: register.device("mine", {"mass_kg": 1.0}),
        "got no value for damping_N_s_m",
    ),
    "no mapping": (
        lambda: register.device("mine", 3),
        "numbers must be DeviceParameters or .* mass_kg",
    ),
    "text": (lambda: register.device("mine", LIGHT | {"mass_kg": "1"}), "mass_kg .* 1"),
    "range": (lambda: register.device("mine", LIGHT | {"mass_kg": -1.0}), "mass_kg .* -1"),
    "hand": (lambda: register.hand("mine", {}, like="robot"), "hand .* ro"),
    "profile": (lambda: register.tool("mine", lambda width: 0), "tool mine .* diameter_m"),
    "keys": (lambda: register.tool("mine", cylinder, keys=("width_mm",)), "width_mm"),
    "no file": (lambda: register.material("none.toml"), r"none\.toml"),
    "no scene": (lambda: register.scene("none.toml"), r"none\.toml"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_registered_is_refused_in_a_sentence(case):
    call, refusal = REFUSED[case]
    with pytest.raises(InputError, match=refusal) as refused:
        call()
    assert "\n" not in str(refused.value)
    with pytest.raises(InputError):
        load_scene("wall", {"device": "mine"})


@pytest.mark.parametrize(
    ("text", "refusal"),
    [
        ("[bone.foam.a]", "bone in"),
        (FOAM.replace("cutting.foam", "cutting.bone"), "got bone in"),
        (FOAM.replace("radial_chip_N_mm2", "chip"), "got no value for radial_chip_N_mm2 in"),
        (f"{FOAM}\n[cutting.foam.chip]\nvalue = 1.0", "Remove chip"),
        (FOAM.replace('"made up"', '""'), "tangential_chip_N_mm2.source"),
        (FOAM.replace("15.0", "1500.0"), "tangential_chip_N_mm2 .*1500"),
        (GEL.replace("poisson_ratio", "poisson"), "poisson_ratio"),
        ("[cutting", "TOML"),
    ],
)
def test_a_material_file_with_a_fault_is_refused_whole(tmp_path, text, refusal):
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(InputError, match=refusal):
        register.material(tmp_path / "mine.toml")
    with pytest.raises(InputError, match="must be one of"):
        load_scene("milling", {"cutting.material": "foam"})
