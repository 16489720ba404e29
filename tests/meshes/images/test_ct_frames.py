"""Position of the bone in one CT stored as DICOM, NIfTI, NRRD and MetaImage.

The files are stored in other orders, shifted and oblique.

The truth is read without the readers under test: positions as text in the DICOM files, pixels by
Pillow's JPEG 2000.
"""

import io

import image_writers as write
import numpy as np
import pytest
from image_surface import image_surface
from scipy.ndimage import binary_opening
from scipy.spatial import cKDTree

from meshes.images.reading import read_image
from meshes.voxels.mesh_sampling import triangle_distance

BONE_HU = 300.0
WINDOW = (slice(215, 285), slice(300, 370))
"""Columns and rows that hold a vertebra."""
STORED = {  # which axis of LPS each axis of the array is, and its direction
    "as it is": ((0, 1, 2), (1, 1, 1)),
    "mirrored": ((0, 1, 2), (-1, 1, 1)),
    "upside down": ((0, 1, 2), (1, -1, -1)),
    "permuted": ((2, 0, 1), (1, 1, 1)),
    "permuted and mirrored": ((1, 2, 0), (-1, 1, -1)),
}
SHIFT = np.array([12.5, -40.25, 7.75])


class Ct:
    """Values in HU along LPS, the spacing, and the centre of the first voxel [mm]."""

    def __init__(self, values, spacing, origin):
        self.values, self.spacing, self.origin = values, spacing, origin


def element(data, tag, kind):
    """Numbers of a text element of explicit little endian, by its bytes."""
    at = data.index(tag + kind) + 8
    length = int.from_bytes(data[at - 2 : at], "little")
    return np.array([float(word) for word in data[at : at + length].decode().split("\\")])


@pytest.fixture(scope="module")
def whole(anatomy):
    from PIL import Image

    slices = []
    for file in (anatomy / "ct" / "dicom").iterdir():
        data = file.read_bytes()
        assert element(data, b"\x28\0\x52\x10", b"DS") == [-1024.0] and element(
            data, b"\x28\0\x53\x10", b"DS"
        ) == [1.0]
        assert element(data, b"\x20\0\x37\0", b"DS").tolist() == [1, 0, 0, 0, 1, 0]
        pixels = np.array(Image.open(io.BytesIO(data[data.index(b"\xff\x4f\xff\x51") :])))
        assert not (pixels & 15).any()  # Pillow fills 16 bits with the file's 12
        spacing = element(data, b"\x28\0\x30\0", b"DS")
        slices.append(
            (element(data, b"\x20\0\x32\0", b"DS"), pixels.T.astype(np.int32) // 16 - 1024, spacing)
        )
    slices.sort(key=lambda one: one[0][2])
    places = np.array([one[0] for one in slices])
    steps = np.diff(places, axis=0)
    assert np.allclose(steps, [0, 0, 2.0])
    values = np.stack([one[1] for one in slices], axis=2).astype(np.int16)
    return Ct(values, np.array([slices[0][2][1], slices[0][2][0], 2.0]), places[0])


@pytest.fixture(scope="module")
def part(whole):
    """A window of the CT with bone in it."""
    first = np.array([WINDOW[0].start, WINDOW[1].start, 0])
    return Ct(whole.values[WINDOW], whole.spacing, whole.origin + whole.spacing * first)


@pytest.fixture(scope="module")
def bone(part):
    """Return the surface of the bone in the window [mm], from the truth.

    It is made by marching cubes, with the affine written out.
    """
    return surface(part.values, part.spacing, part.origin)


def surface(values, spacing, origin):
    """Vertices [mm] and triangles around the bone."""
    from skimage.measure import marching_cubes

    vertices, faces, _, _ = marching_cubes(
        np.pad(values.astype(np.float32), 1, constant_values=-1024.0), BONE_HU
    )
    return (vertices - 1.0) * spacing + origin, faces


def save(folder, kind, values, axes, origin):
    path = folder / f"ct{kind}"
    if kind == "dicom":
        write.write_dicom(path, (values.astype(np.int32) + 1024).astype(np.uint16), axes, origin)
    elif kind.startswith(".nii"):
        # raw numbers as many scanners' exports hold them, HU by the intercept
        write.write_nifti(
            path,
            (values.astype(np.int32) + 1024).astype(np.uint16),
            axes,
            origin,
            intercept=-1024.0,
        )
    elif kind == ".nrrd":
        write.write_nrrd(
            path, values, axes, origin, space="right-anterior-superior", encoding="gzip"
        )
    else:
        write.write_meta(path, values, axes, origin)
    return path


def stored(ct, turn):
    """Return the same physical values as an array along other axes."""
    order, signs = turn
    values = np.transpose(ct.values, order)[tuple(slice(None, None, sign) for sign in signs)]
    axes, origin = np.zeros((3, 3)), ct.origin.copy()
    for k, (axis, sign) in enumerate(zip(order, signs, strict=True)):
        axes[axis, k] = sign * ct.spacing[axis]
        if sign < 0:
            origin[axis] += ct.spacing[axis] * (ct.values.shape[axis] - 1)
    return np.ascontiguousarray(values), axes, origin


def test_jpeg_2000_dicom_is_read_where_it_lies(anatomy, whole):
    found = read_image(anatomy / "ct" / "dicom")
    assert np.array_equal(found.values, whole.values)
    assert found.spacing_mm == pytest.approx(whole.spacing, abs=1e-12) and found.notes == ()
    assert found.origin_mm == pytest.approx(whole.origin, abs=1e-9)


def test_labels_of_the_ct_lie_on_it(anatomy, whole):
    """Labels of the CT lie on its bone.

    The label file, stored along other axes than the DICOM series, marks its vertebrae (32, 33).
    """
    labels = read_image(anatomy / "ct" / "example_seg_dicom.nii.gz", labels=True)
    assert labels.values.shape == whole.values.shape and labels.origin_mm == pytest.approx(
        whole.origin, abs=1e-4
    )
    vertebrae = np.isin(labels.values, (32, 33))
    assert vertebrae.sum() > 1000
    assert whole.values[vertebrae].mean() > whole.values[vertebrae[::-1]].mean() + 100.0
    assert whole.values[vertebrae].mean() > whole.values[vertebrae[:, ::-1]].mean() + 100.0


@pytest.mark.parametrize("kind", ["dicom", ".nii", ".nii.gz", ".nrrd", ".mhd"])
def test_other_headers_leave_the_bone_where_it_is(tmp_path, part, kind):
    """Exactly: only the order in the file differs. 1e-4 mm: NIfTI holds its place in single
    precision.
    """
    for number, turn in enumerate(STORED.values()):
        for shift in (np.zeros(3), SHIFT):
            folder = tmp_path / f"{number}{bool(shift.any())}"
            folder.mkdir()
            values, axes, origin = stored(part, turn)
            found = read_image(save(folder, kind, values, axes, origin + shift))
            assert np.array_equal(found.values, part.values)
            assert found.spacing_mm == pytest.approx(part.spacing, abs=1e-6)
            assert found.origin_mm == pytest.approx(part.origin + shift, abs=1e-4)


def inside(part, points):
    """Return the points 3 mm or more inside the window.

    At its faces bone is cut off, and each program ends it differently.
    """
    last = part.origin + part.spacing * (np.array(part.values.shape) - 1)
    return ((points > part.origin + 3.0) & (points < last - 3.0)).all(axis=1)


def away(points, vertices, faces):
    """Distance [mm] of points from a surface."""
    return np.abs(triangle_distance(vertices, faces, points))


def near_thick(part, points, mask):
    """Return True for each point [mm] whose nearest voxel of a kind lies in a solid block.

    A solid block is 2 x 2 x 2 voxels of that kind.
    """
    voxels = np.argwhere(mask)
    _, nearest = cKDTree(voxels * part.spacing + part.origin).query(points)
    return binary_opening(mask, np.ones((2, 2, 2)))[tuple(voxels[nearest].T)]


def test_bone_surface_is_that_of_the_truth(tmp_path, part, bone):
    """The whole path to a surface. Single precision in mm 800 mm from the origin; merging moves
    by a millionth.
    """
    values, axes, origin = stored(part, STORED["permuted and mirrored"])
    found = image_surface(
        read_image(save(tmp_path, ".nrrd", values, axes, origin)), threshold=BONE_HU
    )
    points = 1e3 * found.vertices_m
    apart, _ = cKDTree(bone[0]).query(points[inside(part, points)])
    assert len(apart) > 10_000 and np.quantile(apart, 0.99) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["dicom", ".nii.gz", ".nrrd", ".mhd"])
@pytest.mark.parametrize("order", ["as it is", "permuted and mirrored"])
def test_oblique_ct_gives_the_same_bone_within_half_a_voxel(tmp_path, part, bone, kind, order):
    """An oblique CT gives the same bone within half a voxel.

    The patient is turned by 17 and 9 degrees: the voxels are equal, the directions are not, so the
    truth is turned bone. Where the bone and the matter next to it are two voxels thick, every point
    of the surface is found within half a voxel, which is 2 mm along z. Farther off are only points
    of thinner bone, which falls between the new voxels: 24 of 14,568.
    """
    a, b = np.radians(17.0), np.radians(9.0)
    about_z = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    about_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    turn = about_z @ about_x
    values, axes, origin = stored(part, STORED[order])
    found = read_image(save(tmp_path, kind, values, turn @ axes, turn @ origin))
    assert "oblique" in found.notes[-1]
    points, triangles = surface(found.values, np.array(found.spacing_mm), np.array(found.origin_mm))
    points = points @ turn
    truth = bone[0][inside(part, bone[0])]
    missed, apart = away(truth, points, triangles), away(points[inside(part, points)], *bone)
    half = 0.5 * part.spacing.max()
    thick = near_thick(part, truth, part.values > BONE_HU) & near_thick(
        part, truth, part.values <= BONE_HU
    )
    assert thick.mean() > 0.4 and missed[thick].max() < half
    assert np.mean(missed > half) < 0.005 and np.mean(apart > half) < 0.002
    _, nearest = cKDTree(truth).query(points[inside(part, points)])
    assert np.linalg.norm((truth[nearest] - points[inside(part, points)]).mean(axis=0)) < 0.1
