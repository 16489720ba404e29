"""Position of the bone in one CT stored as DICOM, NIfTI, NRRD and MetaImage.

The files are stored in other orders, shifted and oblique.

The truth is read without the readers under test: positions as text in the DICOM files, pixels by
Pillow's JPEG 2000.
"""

import io

import numpy as np
import pytest

from meshes.images.reading import read_image


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


def test_jpeg_2000_dicom_is_read_where_it_lies(anatomy, whole):
    found = read_image(anatomy / "ct" / "dicom")
    assert np.array_equal(found.values, whole.values)
    assert found.spacing_mm == pytest.approx(whole.spacing, abs=1e-12)
    assert found.origin_mm == pytest.approx(whole.origin, abs=1e-9)
    # its header states a thickness of 3 mm
    assert found.notes == (
        "The slices of dicom are 3 mm thick and 2 mm apart: thinner parts are blurred.",
    )


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
