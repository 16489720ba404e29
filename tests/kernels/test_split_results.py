"""Results of launches in parts, which equal the whole ones bit for bit.

This holds whether or not the machine would split them.
"""

import numpy as np
import pytest
import trimesh
from contact_slab import Slab, along, away
from tet_bodies import distorted
from tooth_bodies import at_bottom, block, particle_stress

import kernels.launcher as launcher
from kernels.launcher import SplitLaunch
from meshes.voxels.volume import density_volume
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr
from tissue.fem.assembly import assemble
from tissue.fem.hyperelastic import NonlinearBody
from tissue.fem.space import Space
from tissue.materials.constants import cutting_coefficients
from tissue.materials.elasticity import lame, stiffness_of_lame
from tissue.materials.hyperelasticity import Hyperelastic
from tissue.models.bone.engagement import EngagedBone, chip_nodes
from tissue.models.bone.model import BoneModel
from tissue.models.organ.probe import ShellProbe
from tissue.models.tissue_model import ToolMotion
from tissue.models.tooth.body import ParticleBody


def assert_parts_equal_whole(run, monkeypatch):
    """Assert that launches in three parts, the last part first, give the results of whole launches."""
    split = []

    def in_parts(self):
        parts = self._parts if self._pool is not None else [self._whole]
        split.append(len(parts))
        for part in reversed(parts):
            part()

    with monkeypatch.context() as patch:
        patch.setattr(launcher, "core_count", lambda: 1)
        whole = run(1)
    with monkeypatch.context() as patch:
        patch.setattr(launcher, "core_count", lambda: 3)
        patch.setattr(SplitLaunch, "__call__", in_parts)
        parts = run(3)
    assert max(split) == 3
    assert len(whole) == len(parts) > 0
    for one, other in zip(whole, parts, strict=True):
        assert np.asarray(one).any()
        np.testing.assert_array_equal(one, other)


def test_bone(monkeypatch):
    """Carving, forces and unit loads of a ball that moves down and sideways."""

    def run(cores):
        volume = density_volume(
            np.full((40,) * 3, 1500.0), spacing_mm=0.1, origin_mm=(-2.0, -2.0, -4.0)
        )
        cutter = Cutter(ball_burr(diameter_m=2e-3), 5, 700.0)
        bone = BoneModel(
            volume, cutter, (cutting_coefficients("bone"),), shell_spacing_m=8e-5, cores=cores
        )
        engaged = EngagedBone(bone, chip_nodes(2e-5))
        motion, found = ToolMotion(speed_m_s=4e-3), []
        motion.heading[0] = (0.6, 0.0, -0.8)
        for tick in range(12):
            motion.tip_m[:] = 5e-5 * tick * motion.heading[0] - [0.0, 0.0, 8e-4]
            (bone.advance if tick else bone.place)(motion)
            found.append(bone.respond(motion).wrench.copy())
        engaged.respond(motion)
        return [*found, engaged.unit_loads[0].copy(), bone.store.remaining.numpy(), bone.removed_m3]

    assert_parts_equal_whole(run, monkeypatch)


@pytest.mark.parametrize("order", [1, 2])
def test_tetrahedra(monkeypatch, order):
    """Assembly, and energy, force and tangent of a hyperelastic law."""

    def run(cores):
        space = Space(distorted(2), order)
        constants = lame(5e3, 0.4)
        moved = 2e-3 * np.random.default_rng(0).normal(size=space.nodes_m.shape)
        found = [
            assemble(space, each).data
            for each in (constants, stiffness_of_lame(constants[None])[0])
        ]
        ogden = Hyperelastic.mooney_rivlin(700.0, 250.0, bulk_Pa=97e3)
        body = NonlinearBody(space, law=ogden)
        found += [*body.energy_and_force(moved), body.stiffness(moved).data]
        return found

    assert_parts_equal_whole(run, monkeypatch)


def test_a_shell_on_an_organ(monkeypatch):
    slab = Slab()
    ball = trimesh.creation.icosphere(2, 0.012)
    ball.apply_translation([0.0, 0.0, 0.012])

    def run(cores):
        contact = slab.contact(ShellProbe.from_mesh(ball, points=300), friction=0.2, cores=cores)
        result = along(contact, away([0.002, 0.001, -0.004]))
        return [result.force_N.copy(), result.torque_Nm.copy(), result.nodal_forces_N.copy()]

    assert_parts_equal_whole(run, monkeypatch)


def test_particles_of_a_tooth(monkeypatch):
    def run(cores):
        particles, grid = block(
            (6, 5, 7), 1e-3, modulus_Pa=lambda x: np.where(x[:, 0] < 2.5e-3, 2e6, 84e9)
        )
        body = ParticleBody(particles, grid, at_bottom(grid), cores=cores)
        moved = body.solve(
            body.spread(np.array([3e-3, 2e-3, 7e-3]), np.array([1.0, 0.0, -2.0]))
        ).displacement_m
        return [moved, particle_stress(body.cells, moved), body.matrix().toarray()]

    assert_parts_equal_whole(run, monkeypatch)
