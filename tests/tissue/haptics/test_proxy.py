"""Laws of the proxy over random scenes of solids, and its refusals.

It has three and six degrees of freedom.
"""

import numpy as np
import pytest
from field_distance import distance_to, half_space
from proxy_scenes import BURR, surface_of, wander
from scipy.spatial.transform import Rotation

from meshes.base.errors import InputError
from tissue.haptics.proxy.proxy import Box, ContactField, Proxy, ToolShell
from tissue.motion.quaternion import turn_between

SOLID_TOLERANCE_M = 2.5e-5
"""Depth [m] at which a step next to solids is taken back: a tenth of 0.25 mm.

A settled proxy keeps 1e-9.
"""


def solids_scene(seed):
    """A plane, a box askew and a cube."""
    random = np.random.default_rng(seed)
    turn = Rotation.random(random_state=seed).as_matrix()
    return ContactField(
        half_space((0.0, 0.0, 0.0), random.normal(size=3) * [0.2, 0.2, 0.0] + [0.0, 0.0, 1.0]),
        Box((4e-3, 0.0, 1e-3), (4e-3, 3e-3, 2e-3), turn),
        Box((-4e-3, 1e-3, 0.0), (4e-3, 4e-3, 4e-3)),
    )


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.4])
@pytest.mark.parametrize("seed", range(4))
def test_never_inside_solids(seed, friction):
    field = solids_scene(seed)
    half = np.array([1e-3, 0.7e-3, 0.5e-3])
    corners = half * np.array(
        [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z]
    )
    shell = ToolShell(corners, np.zeros_like(corners), 0.2e-3)
    proxy = Proxy(shell, field, lever_m=3e-3, friction=friction)
    proxy.place(np.array([0.0, 0.0, 8e-3]))
    touched = 0
    for position, turn in wander(seed, ticks=1500, low=-8e-3, high=9e-3, start=(0.0, 0.0, 8e-3)):
        result = proxy.advance(position, turn)
        depth = shell.radius_m - distance_to(field, surface_of(shell, result))[0].min()
        assert depth <= SOLID_TOLERANCE_M
        if result.settled and result.contacts:
            assert depth <= 1e-9
            # The coupling pulls exactly what the contacts push.
            assert result.push_m == pytest.approx(result.position_m - position, abs=1e-9)
            moment = proxy_moment(result, turn)
            assert result.push_moment_m2 == pytest.approx(moment, abs=1e-11)
            touched += 1
    assert touched > 50


def proxy_moment(result, device):
    """Rotational spring's moment over the stiffness, for a lever of 3 mm [m2]."""
    return 9e-6 * np.array(turn_between(device, result.quaternion))


def test_turning_everything_turns_the_proxy():
    """Solids, device and first pose turned and shifted together: so is the answer."""
    turn, shift = Rotation.random(random_state=3), np.array([0.2, -0.1, 0.3])
    box = Rotation.random(random_state=4).as_matrix()

    def scene(rotation, move):
        place = lambda p: rotation.apply(p) + move  # noqa: E731
        return ContactField(
            half_space(place([0, 0, 0]), rotation.apply([0, 0, 1])),
            Box(place([2e-3, 0, 1e-3]), (4e-3, 3e-3, 2e-3), rotation.as_matrix() @ box),
        )

    plain = Proxy(BURR, scene(Rotation.identity(), np.zeros(3)), lever_m=4e-3, friction=0.3)
    moved = Proxy(BURR, scene(turn, shift), lever_m=4e-3, friction=0.3)
    start = np.array([0.0, 0.0, 6e-3])
    plain.place(start)
    moved.place(turn.apply(start) + shift, turn.as_quat())
    touched = 0
    for position, pose in wander(
        5, ticks=1500, low=(-3e-3, -3e-3, -1e-3), high=(3e-3, 3e-3, 4e-3), start=start
    ):
        one = plain.advance(position, pose)
        two = moved.advance(
            turn.apply(position) + shift, (turn * Rotation.from_quat(pose)).as_quat()
        )
        if not (one.settled and two.settled):
            break
        assert turn.apply(one.position_m) + shift == pytest.approx(two.position_m, abs=1e-7)
        assert turn.apply(one.push_m) == pytest.approx(two.push_m, abs=1e-7)
        touched += one.contacts > 0
    assert touched > 50


def test_work_of_a_tick_is_bounded_and_goes_on_in_the_next(monkeypatch):
    """A jump along a plane needs more steps than a tick has; the next ticks finish it."""
    monkeypatch.setattr("tissue.haptics.proxy.proxy.STEP_LIMIT", 10)
    proxy = Proxy(ToolShell.ball(), ContactField(half_space((0, 0, 0), (0, 0, 1))))
    proxy.place(np.array([0.0, 0.0, 1e-3]))
    device = np.array([6e-3, 0.0, -1e-3])
    ticks = 0
    while not proxy.advance(device).settled:
        ticks += 1
    assert 1 < ticks < 10
    assert proxy.result.position_m == pytest.approx([6e-3, 0.0, 0.0], abs=1e-9)


def test_a_wild_device_ends_in_a_finite_pose():
    """A wild device ends in a finite pose.

    It is 1e9 m away, turned by half a circle, next to a wall.
    """
    proxy = Proxy(BURR, ContactField(half_space((0, 0, 0), (0, 0, 1))), lever_m=0.01)
    proxy.place(np.array([0.0, 0.0, 1e-3]))
    for device in (np.array([0.0, 0.0, -1e9]), np.array([1e9, 1e9, -1e9])):
        result = proxy.advance(device, np.array([1.0, 0.0, 0.0, 0.0]))
        assert np.isfinite(result.position_m).all()
        assert surface_of(BURR, result)[:, 2].min() > -SOLID_TOLERANCE_M
    home = np.array([0.0, 0.0, 0.1])
    assert any((proxy.advance(home).position_m == home).all() for _ in range(20))


def test_not_a_number_is_refused_and_changes_nothing():
    proxy = Proxy(ToolShell.ball(), ContactField(half_space((0, 0, 0), (0, 0, 1))))
    proxy.place(np.array([0.0, 0.0, 1e-3]))
    with pytest.raises(InputError, match="finite"):
        proxy.advance(np.array([0.0, np.nan, 0.0]))
    with pytest.raises(InputError, match="finite"):
        proxy.advance(np.zeros(3), np.array([0.0, 0.0, np.inf, 1.0]))
    assert (proxy.result.position_m == [0.0, 0.0, 1e-3]).all()
    with pytest.raises(InputError, match=r"outside all obstacles, got .*, about 1 mm deep"):
        proxy.place(np.array([0.0, 0.0, -1e-3]))
