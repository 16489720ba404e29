"""A user's device in the loop: figures equal to a scene's, safe hold, bone made along its path."""

import numpy as np
import pytest
import pyvista

import tissue
from tissue.haptics.device.recorded import RecordedDevice

BURR = tissue.cutters.ball_burr(diameter_mm=3, flutes=6, spin_rpm=20_000)
START_MM = np.array([-3.0, 0.0, 1.0])


class Moves:
    """A device that goes along a path of its own [m], and keeps what it was commanded."""

    def __init__(self, path):
        self.path, self.commands, self.entered = path, [], 0

    def __enter__(self):
        self.entered += 1
        return self

    def __exit__(self, *error):
        self.entered -= 1

    def read(self, time_s):
        return tissue.Sample(time_s, tuple(self.path(time_s)))

    def command(self, force_N, torque_Nm):
        self.commands.append(force_N.copy())


class Line:
    """Predictor with two methods that continues the force along its line."""

    def __init__(self):
        self.now = self.before = np.zeros(3)

    def observe(self, position_m, velocity_m_s, force_N):
        if force_N is not None:
            self.before, self.now = self.now, force_N

    def predict(self, ticks):
        return self.now + 0.1 * ticks * (self.now - self.before)


def down(time_s):
    """3 mm down in 0.3 s, then 2 mm to the side."""
    return 4e-3 * max(time_s - 0.3, 0.0), 0.0, -0.01 * min(time_s, 0.3)


def bone():
    return tissue.Bone.block((12, 8, 5), spacing_mm=0.25)


def test_a_loop_gives_what_a_scene_gives():
    entries = {
        "anatomy.size_mm": [12, 8, 5],
        "voxels.spacing_mm": 0.25,
        "tool.kind": "ball-burr",
        "tool.diameter_mm": 3.0,
        "tool.flutes": 6,
        "tool.spin_rpm": 20_000,
        "motion.points_mm": [START_MM.tolist(), [3, 0, -3]],
        "device": "touch",
        "coupling.stiffness_N_m": 400.0,
        "coupling.force_scale": 0.05,
        "prediction": "kalman",
        "coupling.delay_ms": 2,
        "duration_s": 0.4,
    }
    times = 1e-3 * np.arange(401)
    path = np.array([down(time) for time in times])
    scene = tissue.simulate(
        tissue.load_scene("milling", entries), device=RecordedDevice(times, path + 1e-3 * START_MM)
    )
    loop = tissue.Loop(
        bone(),
        BURR,
        device=RecordedDevice(times, path),
        start_mm=START_MM,
        stiffness_N_m=400.0,
        force_scale=0.05,
        predictor="kalman",
        delay_ms=2,
    ).run(0.4)
    played = scene.trace.vectors("device_force", "N")
    assert np.abs(played).max() > 0.3
    error, size = np.abs(loop.trace.vectors("device_force", "N") - played), np.abs(played).max()
    # Another origin of the voxels changes the rounding of positions in single precision. Measured:
    # 0.004 % (RMS), 0.016 % in single ticks, and 0.12 % of the removed volume.
    assert np.sqrt((error**2).mean()) < 6e-5 * size and error.max() < 2.5e-4 * size
    assert loop.trace["removed_mm3"][-1] == pytest.approx(scene.trace["removed_mm3"][-1], rel=2e-3)


def test_steps_and_runs_are_the_same_and_leave_the_device_at_zero():
    stepped, device = bone(), Moves(down)
    with tissue.Loop(stepped, BURR, device=device, start_mm=START_MM) as loop:
        assert device.entered == 1
        rows = [dict(loop.step()) for _ in range(430)]
    assert (
        device.entered == 0
        and not device.commands[-1].any()
        and np.abs(device.commands).max() > 0.1
    )
    ran = tissue.Loop(bone(), BURR, device=Moves(down), start_mm=START_MM).run(0.43)
    wanted = [row["model_force_z_N"] for row in rows]
    np.testing.assert_allclose(ran.trace["model_force_z_N"], wanted, rtol=1e-9, atol=1e-9)
    assert stepped.removed.volume_mm3 > 0.05
    assert len(ran.to_pandas()) == 430 == ran.ticks


def test_a_predictor_of_ones_own_predicts():
    loop = tissue.Loop(
        bone(), BURR, device=Moves(down), start_mm=START_MM, predictor=Line(), delay_ms=2
    ).run(0.4)
    assert (
        loop.trace["predicted_by"].any() and np.abs(loop.trace["predicted_force_z_N"]).max() > 0.1
    )


def test_bone_is_made_where_the_tool_goes():
    """Bone is made along the tool's path.

    The tool leaves the first 2 mm, and cuts the bone farther on.
    """
    long_block = tissue.Bone.block((60, 8, 5), spacing_mm=0.25)
    path = lambda time_s: (0.05 * time_s, 0.0, -3e-3)  # noqa: E731
    loop = tissue.Loop(
        long_block,
        BURR,
        device=Moves(path),
        start_mm=(-27, 0, 2.2),
        reach_mm=2.0,
        force_scale=1e-3,
        stiffness_N_m=400.0,
    )
    first = len(long_block.voxel_bone.store.places)
    loop.run(0.6)
    assert len(long_block.voxel_bone.store.places) > 2 * first
    force = np.abs(loop.trace["model_force_x_N"])
    assert (
        loop.trace["tool_x_mm"][-1] > -10.0
        and force[-50:].mean() > 0.3 * force[200:300].mean() > 0.0
    )


def test_an_organ_pushes_back_as_when_it_is_pressed():
    """An organ pushes back as in a press.

    For a slow device that ends 2 mm deep, the balance of spring and organ lies on the curve of a
    press.
    """
    organ = tissue.Organ.block((40, 40, 20), modulus_kPa=8, poisson_ratio=0.45, edge_mm=5)
    ball = tissue.ball(diameter_mm=10)
    path = lambda time_s: (0.0, 0.0, -0.005 * min(time_s, 0.5))  # noqa: E731
    loop = tissue.Loop(organ, ball, device=Moves(path), start_mm=(0, 0, 0.5), reach_mm=3.0).run(1.0)
    depth, force = -loop.trace["tool_z_mm"][-1], loop.trace["model_force_z_N"][-1]
    press = organ.press(ball, depth_mm=depth, at_mm=(0, 0, 0))
    assert depth > 1.5
    assert force == pytest.approx(np.linalg.norm(press.force_N), rel=0.05)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"device": object()}, "device must have the methods read and command"),
        ({"device": Moves}, r"got the class Moves. Give Moves\(\)"),
        ({"predictor": Line}, r"got the class Line. Give Line\(\)"),
        ({"limits": {"mass": 0.1}}, "did you mean mass_kg"),
        ({"limits": {"force_limit_N": 3.0}}, "mass_kg and damping_N_s_m"),
        ({"tool": tissue.ball(diameter_mm=3)}, "tool must be a cutter"),
        ({"stiffness_N_m": 2e4}, "^stiffness_N_m must be below .* or set allow_unstable"),
        ({"limits": "tuch"}, "did you mean touch"),
        ({"hand": "surgeon"}, "hand must be one of"),
        ({"renderer": "magic"}, "renderer must be one of"),
        ({"predictor": "oracle"}, "^predictor must be one of .*hold"),
        ({"predictor": "koopman"}, "^predictor_file must be given for the predictor koopman"),
        ({"low_pass_ms": -1.0}, "^low_pass_ms must"),
        ({"motion_scale": 0.0}, "^motion_scale must"),
        ({"predictor": object()}, "must have observe and predict"),
        (
            {"predictor_file": "a.npz"},
            "predictor_file must be given only if predictor is a name, got predictor=None",
        ),
        ({"axis": (0, 0, 0)}, "axis must"),
        ({"reach_mm": 0.0}, "reach_mm must"),
        ({"delay_ms": 0.5}, "delay_ms"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(options, words):
    with pytest.raises(tissue.InputError, match=words) as refused:
        tissue.Loop(
            **{"tissue": bone(), "tool": BURR, "device": Moves(down), "start_mm": START_MM}
            | options
        )
    assert "\n" not in str(refused.value)


def test_a_refused_coupling_leaves_the_bone_as_it_was():
    block = bone()
    with pytest.raises(tissue.InputError, match="stiffness_N_m"):
        tissue.Loop(block, BURR, device=Moves(down), start_mm=START_MM, stiffness_N_m=2e4)
    assert len(block.voxel_bone.store.places) == 0


def test_a_predictor_without_training_ignores_a_file():
    block = bone()
    plain = tissue.Loop(block, BURR, device=Moves(down), predictor="hold")
    loop = tissue.Loop(
        block, BURR, device=Moves(down), predictor="hold", predictor_file="missing.npz"
    )
    assert loop.notes == plain.notes


def test_a_loop_that_is_not_held_or_full_is_refused():
    loop = tissue.Loop(bone(), BURR, device=Moves(down), start_mm=START_MM, longest_s=0.01)
    with pytest.raises(tissue.InputError, match="with loop"):
        loop.step()
    with pytest.raises(tissue.InputError, match="longest_s"):
        loop.run(0.02)


def test_default_start_is_outside_a_curved_organ():
    """The tool starts outside the organ, above the highest point of the ray along its axis."""
    surface = pyvista.Sphere(radius=40.0, theta_resolution=24, phi_resolution=24)
    dimple = np.exp(-np.sum(((surface.points - [0, 0, 40]) / 15.0) ** 2, axis=1))
    surface.points = surface.points * (1.0 - 0.5 * dimple[:, None])
    organ = tissue.Organ.from_surface(
        surface, modulus_kPa=6, poisson_ratio=0.45, edge_mm=14, order=1
    )
    for axis in ((0, 0, 1), (-0.5, 0, 0.866)):
        loop = tissue.Loop(organ, tissue.ball(diameter_mm=30), device=Moves(down), axis=axis)
        assert loop.row["contact_mm2"] == 0.0
    with pytest.raises(tissue.InputError, match=r"^start_mm must start outside the organ"):
        tissue.Loop(organ, device=Moves(down), start_mm=(30, 0, 0))
