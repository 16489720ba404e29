"""A needle's force along a log: the engine's own, with right derivatives, and jumps where the log has them."""

from dataclasses import replace

import numpy as np
import pytest

from tissue.fitting.measured import MeasuredLoads
from tissue.fitting.needle import NeedleForward, needle_names
from tissue.fitting.needle_search import with_jumps
from tissue.fitting.needle_walls import Wall
from tissue.fitting.parameter import Parameter
from tissue.materials.constants import constants
from tissue.materials.prior import Prior
from tissue.models.needle.model import NeedleModel
from tissue.models.needle.parameters import needle_tissue, vessel_wall
from tissue.models.tissue_model import ToolMotion

STEP_S, FEED_M_S = 4e-3, 0.01
NOISE_N = 0.005


def travel():
    """In through capsule and wall, a rest, and out again, but not out of the wall's hole."""
    deep = np.arange(-0.002, 0.06, STEP_S * FEED_M_S)
    return np.concatenate([deep, np.full(40, deep[-1]), np.arange(deep[-1], 0.02, -STEP_S * FEED_M_S)])


@pytest.fixture(scope="module")
def engine():
    """A forward of the cited constants, and the force of the engine's model along the same travel."""
    names = needle_names([Wall(0.03)])
    cited = {name: constants(*name.split(".")[:2])[name.split(".")[2]] for name in names}
    forward = NeedleForward(
        tuple(Parameter(name, Prior.of(entry, name)) for name, entry in cited.items()),
        {name: entry.value for name, entry in cited.items()},
        STEP_S * np.arange(len(travel())), travel(), walls=(Wall(0.03),),
    )  # fmt: skip
    model, force = NeedleModel(needle_tissue(walls=[vessel_wall(0.03)]), diameter_m=1.27e-3), []
    for sample, (z, speed) in enumerate(zip(travel(), np.gradient(travel(), STEP_S), strict=True)):
        motion = ToolMotion(tip_m=np.array([0.0, 0.0, -z]), speed_m_s=abs(speed))
        motion.heading[0] = 0.0, 0.0, -np.sign(speed)
        (model.place if sample == 0 else model.advance)(motion)
        force.append(model.respond(motion).wrench[2])
    found, _ = with_jumps(forward, measured(forward, np.array(force)))
    return replace(found, known=forward.known), np.array(force)


def measured(forward, force, seed=0):
    """A log of a force, with noise."""
    noisy = force + NOISE_N * np.random.default_rng(seed).standard_normal(len(force))
    return MeasuredLoads(forward.times_s, noisy[:, None], forward.channels)


def cited_of(forward):
    return np.array([forward.known[name] for name in forward.names])


def test_jumps_are_found_where_the_engine_has_them(engine):
    forward, force = engine
    falls = np.flatnonzero(np.diff(force) < -0.3)
    kinds = [event.kind for event in forward.events]
    assert kinds == ["puncture", "puncture", "slip_out"]
    assert [event.sample for event in forward.events[:2]] == falls.tolist()


def test_load_is_the_engines(engine):
    """Within what the force rises in half a sample before a jump."""
    forward, force = engine
    loads = forward.loads(cited_of(forward))
    assert np.abs(loads[:, 0] - force).max() < 0.5 * np.abs(np.diff(force[:900])).max()
    assert np.abs(loads[:, 0] - force).max() < 0.01


def test_okamura_by_hand(engine):
    """Before the puncture a1 z + a2 z², after it the balance of cutting, hold, friction and pull."""
    forward, _ = engine
    force = forward.loads(cited_of(forward))[:, 0]
    z = forward.travel_m
    at = int(np.searchsorted(z[:1500], 0.01))
    assert force[at] == pytest.approx(48.0 * z[at] + 5200.0 * z[at] ** 2, rel=1e-9)
    at = forward.events[0].sample + 100
    held = 0.94 + 0.65 + 10.57 * z[at]
    u = (-(48.0 + 10.57) + np.sqrt(58.57**2 + 4.0 * 5200.0 * held)) / (2.0 * 5200.0)
    length = z[at] - u
    assert force[at] == pytest.approx(0.94 + 0.65 + (10.57 + 212.0 * FEED_M_S) * length, rel=1e-6)


def test_derivatives_by_differences(engine):
    """At constants that do not agree with the log's jumps: the loads stay smooth in them."""
    forward, _ = engine
    x = cited_of(forward) * (1.0 + 0.1 * np.random.default_rng(1).uniform(-1.0, 1.0, 13))
    slopes = forward.jacobian(x)
    for at in range(len(x)):
        moved = np.zeros(len(x))
        moved[at] = 1e-5 * x[at]
        by = (forward.loads(x + moved) - forward.loads(x - moved)) / (2e-5 * x[at])
        np.testing.assert_allclose(slopes[:, :, at], by, atol=1e-5 * np.abs(by).max())
        assert np.abs(by).max() > 0.0


def test_a_membrane_that_no_jump_breaks_leaves_its_force_alone(engine):
    forward, _ = engine
    slopes = replace(forward, events=()).jacobian(cited_of(forward))
    silent = [name for at, name in enumerate(forward.names) if not slopes[:, :, at].any()]
    assert "needle.liver.capsule_puncture_N" in silent
    assert "needle.liver.linear_N_mm" not in silent


def test_samples_taken_together_are_those_taken_one_by_one(engine, monkeypatch):
    forward, _ = engine
    x = cited_of(forward) * (1.0 + 0.1 * np.random.default_rng(3).uniform(-1.0, 1.0, 13))
    together = forward.loads(x)
    monkeypatch.setattr("tissue.fitting.needle_runs.LEAST", 10**9)
    np.testing.assert_allclose(replace(forward, known=forward.known).loads(x), together, rtol=0.0, atol=1e-12)
