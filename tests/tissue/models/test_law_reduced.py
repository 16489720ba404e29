"""A reduced model of a hyperelastic organ: the full answer in a full basis, presses it was and was not trained on."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshes.base.errors import InputError
from meshes.tets.structured import box
from meshes.tets.tetrahedra import TetMesh
from tissue.fem.sampled_body import SampledBody
from tissue.materials.elasticity import lame
from tissue.materials.hyperelasticity import Hyperelastic
from tissue.models.organ import law as law_module
from tissue.models.organ import law_training
from tissue.models.organ.law import OrganLaw, large_fields_of
from tissue.models.organ.law_reduced import LawReduced
from tissue.models.organ.law_training import ReducedSettings, Trained
from tissue.models.organ.probe import SphereProbe
from tissue.models.organ.soft_organ import SoftOrgan
from tissue.models.tissue_model import TICK_S, ToolMotion

SIZE_M, CELLS, RADIUS_M, DEPTH_M = (0.05, 0.05, 0.025), (8, 8, 4), 8e-3, 4e-3
LAME = lame(5e3, 0.4)
LAW = Hyperelastic.neo_hookean(LAME[1], bulk_Pa=LAME[0] + 2.0 / 3.0 * LAME[1])
SETTINGS = ReducedSettings(modes=40, error=0.005)


def slab(settings: ReducedSettings | None, turn: np.ndarray | None = None, cells=CELLS, friction=0.0) -> SoftOrgan:
    """A slab held at its base, turned or mirrored as a whole."""
    mesh = box(SIZE_M, cells)
    nodes = mesh.nodes_m - [0.5 * SIZE_M[0], 0.5 * SIZE_M[1], SIZE_M[2]]
    held = np.flatnonzero(nodes[:, 2] < -SIZE_M[2] + 1e-9)
    tets = mesh.cells
    if turn is not None:
        nodes = nodes @ turn.T
        tets = tets if np.linalg.det(turn) > 0.0 else tets[:, [1, 0, 2, 3]]
    law = OrganLaw(LAW, np.ones(len(tets)), 0.02, reduced=settings)
    elasticity = np.tile(LAME, (len(tets), 1))
    return SoftOrgan(TetMesh(nodes, tets), elasticity, held, order=1, friction=friction, law=law)


def path(place=(0.0, 0.0), depth_m=DEPTH_M, turn=None) -> tuple[np.ndarray, np.ndarray]:
    """Tips from above a place to a depth there, and the tool's rotation."""
    tips = np.array([[*place, 2e-4], [*place, -depth_m]])
    if turn is None:
        return tips, np.eye(3)
    upright = turn if np.linalg.det(turn) > 0.0 else turn @ np.diag([-1.0, 1.0, 1.0])
    return tips @ turn.T, upright


def model_of(organ: SoftOrgan, tips, rotation, more=()):
    """The model, trained along the tips; `more` are other places that can be touched."""
    all_tips = np.array([*tips, *more])
    return organ.under(
        SphereProbe(RADIUS_M), all_tips, np.tile(rotation, (len(all_tips), 1, 1)), tolerance=1e-5, sweeps=2000
    )[0]


def driven(model, tips, rotation, speed_m_s=0.05, hold=60) -> np.ndarray:
    """Force at the end of a press, shape (3,)."""
    length = np.linalg.norm(tips[1] - tips[0])
    count = int(np.ceil(length / (speed_m_s * TICK_S)))
    motion = ToolMotion(tip_m=tips[0].copy(), rotation=rotation)
    model.place(motion)
    for tick, share in enumerate([*(np.arange(1, count + 1) / count), *np.ones(hold)], start=1):
        motion.tip_m[:] = tips[0] + share * (tips[1] - tips[0])
        model.advance(motion)
        model.respond(motion)
        model.wait_for_background(tick * TICK_S)
    return model.contact.result.force_N.copy()


def whole_basis(organ: SoftOrgan) -> Trained:
    """Every free unknown and every point."""
    values, vectors = np.linalg.eigh(organ.body.stiffness.toarray()[np.ix_(organ.body.free, organ.body.free)])
    modes = np.zeros((organ.space.unknown_count, len(values)))
    modes[organ.body.free] = vectors / np.sqrt(values)
    volumes = organ.space.volumes_m3
    return Trained(
        modes=modes, points=np.arange(len(volumes)), volumes_m3=volumes, error=0.0, missed=1e-9, farthest=1.0
    )


def under_its_forces(organ: SoftOrgan, model) -> np.ndarray:
    """Where the law's equilibrium has the touchable nodes under the contact's forces [m]."""
    touchable = model.fields.node_sets["touchable"]
    moved, _, _ = large_fields_of(organ, organ._law, touchable).under(model.contact.result.nodal_forces_N)
    return moved[touchable]


def test_a_full_basis_at_all_points_gives_the_full_answer(monkeypatch):
    organ = slab(SETTINGS, cells=(4, 4, 2))
    monkeypatch.setattr(law_module, "trained", lambda *_: whole_basis(organ))
    tips, rotation = path()
    model = model_of(organ, tips, rotation)
    force_N = driven(model, tips, rotation)
    exact = under_its_forces(organ, model)
    assert force_N[2] > 0.1
    off = np.linalg.norm(model.displacement_m() - exact) / np.linalg.norm(exact)
    print("full basis off by", off)
    assert off < 2e-3, "the equilibrium is solved to 1e-3"
    model.finish()
    assert not model.notices


def test_a_trained_press_is_that_of_the_law():
    """At rest: force within 1 % of the law solved between ticks, displacement within 3 % of its equilibrium."""
    tips, rotation = path(depth_m=DEPTH_M)
    organ = slab(SETTINGS)
    model = model_of(organ, tips, rotation)
    few = model._law._body
    forces = [driven(model, tips, rotation), driven(model_of(slab(None), tips, rotation), tips, rotation)]
    exact = under_its_forces(organ, model)
    off = np.linalg.norm(model.displacement_m() - exact) / np.linalg.norm(exact)
    print("force", forces, "displacement", off, "points", len(few.points))
    assert (few.volumes_m3 > 0.0).all() and len(few.points) < organ.space.cell_count / 2
    assert forces[0][2] == pytest.approx(forces[1][2], rel=0.01)
    assert off < 0.03
    model.finish()
    assert not model.notices


def test_few_points_do_the_work_of_all_in_what_was_trained(monkeypatch):
    """The error that the training states is that of its summed work, and within what was asked."""
    seen = []

    def kept(work, tolerance, most):
        found = few_points(work, tolerance, most)
        seen.append((work, *found))
        return found

    few_points = law_training.few_points
    monkeypatch.setattr(law_training, "few_points", kept)
    monkeypatch.setattr(law_training, "cached_arrays", lambda _kind, _key, make: make())
    tips, rotation = path()
    model_of(slab(SETTINGS), tips, rotation)
    (work, points, weights, error), goal = seen[0], seen[0][0].sum(axis=1)
    assert (weights > 0.0).all()
    off = np.linalg.norm(work[:, points] @ weights - goal) / np.linalg.norm(goal)
    assert off == pytest.approx(error, rel=1e-6)
    assert off <= SETTINGS.error


def test_rows_summed_with_random_signs_choose_points_and_the_error_is_that_over_all(monkeypatch):
    """A fourth of the rows, of states that have nothing in common: 0.05 is asked, and what is left is stated."""
    tips, rotation = path()
    organ = slab(SETTINGS)
    training = model_of(organ, tips, rotation)._law._training
    whole = SampledBody(organ.space, LAW, np.ones(organ.space.cell_count), training.modes)
    states = np.random.default_rng(2).normal(size=(24, whole.size)) * 0.05 * training.farthest
    monkeypatch.setattr(law_training, "MOST_ROWS", states.size // 4)
    points, volumes, error = law_training._sampled(whole, states, 0.05)
    few = SampledBody(
        organ.space, LAW, np.ones(organ.space.cell_count), training.modes, points=points, volumes_m3=volumes
    )
    off = [np.linalg.norm(few.energy_and_force(q)[1] - whole.energy_and_force(q)[1])
           / np.linalg.norm(whole.energy_and_force(q)[1]) for q in states]  # fmt: skip
    print(len(points), off)
    assert error == pytest.approx(np.sqrt(np.mean(np.square(off))), rel=1e-6)
    assert error < 0.15


def test_a_basis_that_misses_what_it_was_trained_on_is_reported():
    tips, rotation = path()
    model = model_of(slab(ReducedSettings(modes=2, error=0.02)), tips, rotation)
    driven(model, tips, rotation, hold=0)
    assert "of a press that it was trained on" in model.notices[0]


@pytest.mark.parametrize(
    "turn",
    [Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix(), np.diag([-1.0, 1.0, 1.0])],
    ids=["turned", "mirrored"],
)
def test_a_turned_or_mirrored_slab_gives_the_same_force(turn):
    forces = []
    for each in (None, turn):
        tips, rotation = path((3e-3, 1e-3), turn=each)
        force_N = driven(model_of(slab(SETTINGS, each), tips, rotation), tips, rotation)
        forces.append(force_N if each is None else each.T @ force_N)
    print(forces)
    assert np.linalg.norm(forces[1] - forces[0]) < 0.01 * np.linalg.norm(forces[0])


def test_a_drag_with_friction_is_that_of_the_law():
    """Down and 3 mm along: the force within 2 % of the law solved between ticks, sideways by most of the coefficient."""
    down, rotation = path((-1.5e-3, 0.0), 3e-3)
    along = np.array([down[1], down[1] + [3e-3, 0.0, 0.0]])
    forces = []
    for settings in (None, SETTINGS):
        model = model_of(slab(settings, friction=0.3), down, rotation, more=along[1:])
        driven(model, down, rotation, hold=0)
        forces.append(dragged(model, along, rotation))
    model.finish()
    assert not model.notices
    print(forces)
    assert -forces[1][0] > 0.2 * forces[1][2]
    assert np.linalg.norm(forces[1] - forces[0]) < 0.02 * np.linalg.norm(forces[0])


def dragged(model, tips, rotation) -> np.ndarray:
    """Force after a path of 100 ticks from where the tool is, shape (3,)."""
    motion = ToolMotion(tip_m=tips[0].copy(), rotation=rotation)
    for tick in range(1, 101):
        motion.tip_m[:] = tips[0] + 0.01 * tick * (tips[1] - tips[0])
        model.advance(motion)
        model.respond(motion)
        model.wait_for_background(model._ticks * TICK_S)
    return model.contact.result.force_N.copy()


def test_a_press_elsewhere_or_deeper_is_reported():
    tips, rotation = path()
    for to, word in ((path((12e-3, 8e-3))[0], "elsewhere"), (path(depth_m=6.4e-3)[0], "deeper")):
        model = model_of_path(tips, rotation, to)
        driven(model, to, rotation)
        model.finish()
        assert any(f"the organ is pressed {word} than its reduced law was trained" in each for each in model.notices)
        assert "otherwise than its reduced law was trained in" in model.notices[-1]


def model_of_path(tips, rotation, to):
    """A model that is trained on one path and may be led along another."""
    organ = slab(SETTINGS)
    trained = law_module.trained
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(law_module, "trained", lambda *given: trained(*given[:7], tips, given[8][:2], *given[9:]))
        return model_of(organ, tips, rotation, more=to)


def test_ticks_that_do_not_converge_are_counted(monkeypatch):
    """Where every step turns a point over, no tick goes on: each one in contact is reported at the end."""
    tips, rotation = path(depth_m=1e-3)
    model = model_of(slab(SETTINGS), tips, rotation)
    assert isinstance(model._law, LawReduced)
    body = model._law._body
    monkeypatch.setattr(body, "energy_and_force", lambda amounts: (np.inf, 0.0 * amounts))
    driven(model, tips, rotation, hold=0)
    model.finish()
    counted = [each for each in model.notices if "did not converge" in each]
    assert len(counted) == 1
    count, of = (int(word) for word in counted[0].split() if word.isdigit())
    assert 0 < count == of < 30


def test_a_path_that_does_not_touch_is_refused():
    tips = np.array([[0.0, 0.0, 3e-4], [0.0, 0.0, 1e-4]])
    with pytest.raises(InputError, match=r"organ\.law_method must be offset for a tool whose path does not touch"):
        model_of(slab(SETTINGS), tips, np.eye(3))


def test_a_model_is_made_once_and_kept(monkeypatch, tmp_path):
    monkeypatch.setenv("TISSUE_CACHE", str(tmp_path))
    tips, rotation = path()
    first = model_of(slab(SETTINGS), tips, rotation)._law._training
    monkeypatch.setattr(law_training, "press_basis", lambda *_: pytest.fail("made again"))
    second = model_of(slab(SETTINGS), tips, rotation)._law._training
    assert second.modes.tobytes() == first.modes.tobytes()
    assert (second.error, second.missed, second.farthest) == (first.error, first.missed, first.farthest)
