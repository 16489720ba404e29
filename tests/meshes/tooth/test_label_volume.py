"""Tooth from a label image: volumes, place, islands, cavity, refusals, real carious teeth."""

import numpy as np
import pytest

from meshes.images.reading import Image, read_image
from meshes.tooth.label_volume import labelled_tooth
from meshes.tooth.layers import TOOTH_LAYERS

SPACING_MM = 0.1


def tooth_labels():
    """Return labels of a tooth 12 mm long that lies along the first axis, crown at its low end.

    The labels are 1 decay, 2 enamel, 3 dentin. The dentin is 5 x 4 mm across with a cavity of 1 x 1
    x 4 mm. It has 3 mm of enamel over it, and a cube of decay of 1 mm between them.
    """
    values = np.zeros((140, 70, 60), dtype=np.int16)
    values[10:40, 10:60, 10:50] = 2
    values[40:130, 10:60, 10:50] = 3
    values[60:100, 30:40, 25:35] = 0
    values[35:45, 30:40, 15:25] = 1
    return values


def image(values, spacing=(SPACING_MM,) * 3):
    return Image(np.asfortranarray(values), spacing, "test", ())


EXACT_MM3 = {"enamel": 60.0 - 0.5, "dentin": 180.0 - 0.5, "caries": 1.0}
"""Of the tooth with its cavity filled by dentin."""


@pytest.mark.parametrize(("resample_mm", "rel"), [(0.1, 0.1), (0.2, 0.35)])
def test_layers_keep_their_volumes(resample_mm, rel):
    """Layers keep their volumes.

    The bound is 0.5 % for the whole and the large layers; for a lesion five voxels wide it depends
    on whether its faces are half voxels.
    """
    values = tooth_labels()
    values[60:100, 30:40, 25:35] = 3
    volume = labelled_tooth(image(values)).volume(resample_mm=resample_mm)
    assert volume.layer_names == TOOTH_LAYERS and volume.spacing_m == pytest.approx(
        1e-3 * resample_mm
    )
    assert 1e9 * volume.volume_m3() == pytest.approx(sum(EXACT_MM3.values()), rel=5e-3)
    for name, value in EXACT_MM3.items():
        assert 1e9 * volume.volume_m3(name) == pytest.approx(
            value, rel=5e-3 if value > 10.0 else rel
        ), name


def test_cavity_becomes_pulp_by_default():
    remarks = []
    volume = labelled_tooth(image(tooth_labels())).volume(resample_mm=0.1, remark=remarks.append)
    assert 1e9 * volume.volume_m3("pulp") == pytest.approx(4.0, rel=0.1)
    assert any("in the dentin is taken as pulp" in sentence for sentence in remarks)
    assert 1e9 * volume.volume_m3() == pytest.approx(240.0, rel=5e-3)


@pytest.mark.slow
def test_a_real_carious_tooth(anatomy):
    """A real carious tooth has the voxel counts and islands of the data's README.

    The islands hold less than 0.2 mm3.
    """
    remarks = []
    path = anatomy / "tooth" / "caries_tooth_2.nii.gz"
    tooth = labelled_tooth(read_image(path, spacing_mm=0.034, labels=True))
    volume = tooth.volume(resample_mm=0.1, remark=remarks.append)
    # the tooth is one of them
    assert any("Dropped 146 loose pieces" in sentence for sentence in remarks)
    counts = {"caries": 163638, "enamel": 4794143, "dentin": 13024153}
    for name, count in counts.items():
        expected = count * 0.034**3
        rel = 2e-3 if name != "caries" else 0.15  # decay in sheets thinner than 0.1 mm is outvoted
        assert 1e9 * volume.volume_m3(name) == pytest.approx(expected, rel=rel), name
    assert 15e-9 < volume.volume_m3("pulp") < 60e-9
    assert np.ptp(np.array(volume.bounds_m), axis=0)[2] > 17e-3


def test_a_site_over_the_caries_leads_straight_in_from_the_nearest_surface():
    """The cube of decay lies 0.5 mm under the side of the tooth, its middle 1 mm."""
    tooth = labelled_tooth(image(tooth_labels())).at_lesion()
    volume = tooth.volume(resample_mm=0.1)
    index = np.argwhere((volume.layer == TOOTH_LAYERS.index("caries")) & (volume.fraction > 127))
    middle = 1e3 * (volume.origin_m + volume.spacing_m * (index.mean(axis=0) + 0.5))
    assert middle == pytest.approx([0.0, 0.0, -1.0], abs=0.15)
    assert volume.placement.rotation[:, 2] == pytest.approx([0.0, 0.0, -1.0], abs=0.02)
    assert 1e9 * volume.volume_m3() == pytest.approx(240.0, rel=5e-3)
    # back where the labels are: voxels 35-44, 30-39, 15-24
    at = volume.placement.to_file(middle[None])[0]
    assert at == pytest.approx([3.95, 3.45, 1.95], abs=0.1)


def no_pulp(values):
    """Volume of the tooth of labels without any pulp [mm3]; fails where a pulp is found."""
    remarks = []
    volume = labelled_tooth(image(values)).volume(resample_mm=0.1, remark=remarks.append)
    assert volume.volume_m3("pulp") == 0.0
    assert "No label for the pulp: its distance and exposure are unknown." in remarks
    return 1e9 * volume.volume_m3()


def solid():
    """The tooth without cavity and decay: 60 mm3 of enamel over 180 mm3 of dentin."""
    values = tooth_labels()
    values[60:100, 30:40, 25:35] = 3
    values[35:45, 30:40, 15:25] = np.where(np.arange(35, 45)[:, None, None] < 40, 2, 3)
    return values


@pytest.mark.parametrize(
    ("where", "gone_mm3"),
    [
        # a fissure across the crown, open at its ends
        ((slice(0, 35), slice(10, 60), slice(27, 33)), 2.5 * 5.0 * 0.6),
        # a deep one within the crown and the dentin
        ((slice(0, 70), slice(20, 50), slice(27, 33)), 6.0 * 3.0 * 0.6),
        ((slice(0, 60), slice(32, 38), slice(27, 33)), 5.0 * 0.6 * 0.6),  # a pit
        ((slice(60, 120), slice(0, 30), slice(27, 33)), 6.0 * 2.0 * 0.6),  # a groove along a root
        # a hole from the crown far into a root
        ((slice(0, 120), slice(32, 38), slice(27, 33)), 11.0 * 0.6 * 0.6),
        ((slice(70, 78), slice(30, 38), slice(25, 33)), 0.8**3),  # a pore: no pulp is as small
        ((slice(18, 30), slice(25, 40), slice(25, 35)), 1.2 * 1.5 * 1.0),  # a hollow in the enamel
    ],
)
def test_a_void_open_to_the_mouth_or_of_other_size_or_place_is_no_pulp(where, gone_mm3):
    values = solid()
    values[where] = 0
    assert no_pulp(values) == pytest.approx(240.0 - gone_mm3, rel=0.01)
