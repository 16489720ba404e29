"""Search for sites.

The site is equal on a moved, turned, mirrored or coarser bone, and refused where there is none.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from joint_bones import NECK, PEDICLE, Rod, as_surface, femur, humerus, solid, vertebra
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from meshes.base.errors import InputError
from meshes.images.bone_image import image_triangles
from meshes.images.reading import read_image
from meshes.surfaces.landmarks import find_site
from meshes.surfaces.surface import read_surface, surface_from_triangles

ANATOMY = Path(__file__).resolve().parents[4] / "shared" / "anatomy"
FEMURS = {"myosim_femur_r.stl": None, "openforge_femur_left.stl": 48.0}
"""Files and their unit [mm]; the second is of no unit, and 450 mm long in this one."""
TURN = Rotation.from_rotvec([0.7, -1.1, 0.4]).as_matrix() @ np.diag([-1.0, 1.0, 1.0])
"""Rotation and mirror image."""
SHIFT = np.array([40.0, -500.0, 7.0])


def angle_deg(one, other):
    return float(np.degrees(np.arccos(np.clip(one @ other, -1.0, 1.0))))


def moved(bone):
    """Return a bone that is mirrored, turned and shifted."""
    vertices = np.array(bone.vertices) @ TURN.T + SHIFT
    return trimesh.Trimesh(vertices, np.array(bone.faces)[:, ::-1], process=False)


@pytest.mark.parametrize(
    ("kind", "bone", "unit_mm"),
    [("femoral-head", femur, 1.0), ("humeral-head", humerus, 1000.0)],
)
def test_axis_and_centre_of_a_head_wherever_the_bone_lies(kind, bone, unit_mm):
    found = find_site(kind, as_surface(moved(bone()).apply_scale(1.0 / unit_mm), scale=unit_mm))
    # a voxel of the neck's or the rim's 15 mm is 4
    assert angle_deg(found.site.rotation[:, 2], TURN @ NECK) < 1.0
    assert np.linalg.norm(1e3 * found.site.centre_m - (23.0 * TURN @ NECK + SHIFT)) < 0.4
    assert found.score > 0.8
    assert found.second_score == 0.0
    assert "radius 23" in found.site.confidence


NO_BONES = {
    "ball": trimesh.creation.icosphere(4, 24.0),
    "box": trimesh.creation.box((60.0, 50.0, 40.0)),
    "shaft": trimesh.creation.cylinder(15.0, 300.0, sections=64),
}


@pytest.mark.parametrize(
    ("kind", "shape"),
    [
        ("glenoid", "shaft"),
        ("femoral-head", "box"),
        ("humeral-head", "shaft"),
        ("vertebra", "ball"),
    ],
)
def test_what_is_no_bone_is_refused(kind, shape):
    with pytest.raises(InputError, match=r"file must contain a .*, got .*\. Check the unit"):
        find_site(kind, as_surface(NO_BONES[shape]))


def test_a_bone_with_two_heads_is_refused():
    bone = femur()
    twin = bone.copy()
    twin.apply_transform(trimesh.transformations.rotation_matrix(np.pi, (1, 0, 0), (0, 0, -150)))
    foot = -46.0 * NECK
    rod = solid(Rod(foot - [0, 0, 60], foot - [0, 20, 200], 12.0))
    both = trimesh.util.concatenate([bone, twin, rod])
    with pytest.raises(InputError, match="got two similar places"):
        find_site("femoral-head", as_surface(both))


@pytest.mark.slow
@pytest.mark.parametrize("side", ["left", "right"])
def test_a_pedicle_of_a_vertebra_that_is_mirrored_and_turned(side):
    found = find_site(f"vertebra:{side}", as_surface(moved(vertebra()))).site
    # the mirror exchanges left and right
    outside = np.array([-1.0 if side == "left" else 1.0, 1.0, 1.0])
    # 1.5 mm at each end of 18 is 9
    assert angle_deg(found.rotation[:, 2], TURN @ (outside * PEDICLE)) < 9.0
    away = np.linalg.solve(TURN, 1e3 * found.centre_m - SHIFT) - outside * [14.0, 8.0, 6.0]
    # 9 degrees over 14 mm
    assert np.linalg.norm(away - (away @ (outside * PEDICLE)) * (outside * PEDICLE)) < 2.3
    assert angle_deg(found.rotation[:, 1], TURN @ [0, 0, 1]) < 10.0
    assert f"{side} pedicle, at least" in found.confidence


@pytest.mark.slow
@pytest.mark.parametrize(("label", "whole"), [(30, False), (31, True)])
def test_vertebrae_of_a_ct(label, whole):
    """The sites of vertebrae are found in a CT.

    Labels of TotalSegmentator are in voxels of 3 mm in LPS: +x is the left, +z up; the edge of the
    image cuts one vertebra off.
    """
    path = ANATOMY / "ct" / "example_seg.nii.gz"
    if not path.is_file():
        pytest.skip("no CT in shared/anatomy")
    image = read_image(path, labels=True)
    mask = np.pad(image.values == label, 2).astype(np.float32)
    start = np.asarray(image.origin_mm) - 2.0 * np.asarray(image.spacing_mm)
    smooth = replace(image, values=gaussian_filter(mask, 0.7), origin_mm=tuple(start))
    vertices, faces = image_triangles(smooth, threshold=0.45)
    surface = surface_from_triangles(vertices, faces, scale_mm=1.0, cut_off=True)
    if not whole:
        with pytest.raises(InputError, match="as in a bone that is cut off"):
            find_site("vertebra", surface)
        return
    found = find_site("vertebra:left", surface)
    assert 1e3 * found.site.centre_m[0] > vertices[:, 0].mean()
    assert found.site.rotation[1, 2] > 0.8  # out of the back
    assert found.site.rotation[2, 1] > 0.8
    assert found.second_score < 0.7 * found.score


@pytest.mark.parametrize("name", FEMURS)
def test_heads_of_real_femurs(name):
    """The heads of real femurs are found.

    The origin of the OpenSim femur is the centre of its head; necks lean 120 to 140 degrees from
    the shaft.
    """
    path = ANATOMY / "bone" / name
    if not path.is_file():
        pytest.skip("no bones in shared/anatomy")
    surface = read_surface(path, scale_mm=FEMURS[name], cut_off=True)
    found = find_site("femoral-head", surface)
    assert found.second_score < 0.5 * found.score
    points = surface.vertices_m - surface.vertices_m.mean(axis=0)
    shaft = np.linalg.svd(points, full_matrices=False)[2][0]
    shaft *= np.sign(shaft @ (found.site.centre_m - surface.vertices_m.mean(axis=0)))
    assert 118.0 < 180.0 - angle_deg(found.site.rotation[:, 2], shaft) < 142.0
    if name.startswith("myosim"):
        middle = found.site.centre_m - 23e-3 * found.site.rotation[:, 2]
        assert np.linalg.norm(middle) < 1.5e-3
