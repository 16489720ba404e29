"""Contact area of a ball for several edge lengths of the mesh, and its note."""

import pytest
import pyvista

import tissue

BALL = tissue.ball(diameter_mm=15)
PLACE_MM = (-30, 0, 0)


def kidney(order):
    """Kidney of the guide on organs, without its cyst."""
    surface = pyvista.ParametricEllipsoid(30, 22, 55, u_res=50, v_res=50, w_res=50)
    surface = surface.triangulate().clean()
    surface.points[:, 0] += 0.006 * surface.points[:, 2] ** 2
    return tissue.Organ.from_surface(
        surface, modulus_kPa=10, poisson_ratio=0.49, held="+x", order=order
    )


def pressed(organ, edge_mm):
    """Press of the ball on the organ, 4 mm deep."""
    fine = organ.refined(edge_mm=edge_mm, near_mm=PLACE_MM)
    return fine.press(BALL, depth_mm=4, at_mm=PLACE_MM)


@pytest.mark.slow
def test_an_area_is_noted_where_it_may_be_wrong_by_ten_per_cent():
    """The baseline is order 2 with edges of 3 mm, 58 to 61 mm2 in four meshes of these edges.

    The mesher gives another mesh in every run.
    """
    linear, quadratic = kidney(1), kidney(2)
    baseline = pressed(quadratic, 3.0)
    assert "contact area" not in baseline.notes
    # longest edges of 0.52, 0.52 and 0.41 radii; measured: 35, 24 and 9 % too small
    for edge_mm, least in ((4.0, 0.2), (3.5, 0.1), (3.0, 0.02)):
        press = pressed(linear, edge_mm)
        assert "contact area" in press.notes
        assert press.area_mm2 < (1.0 - least) * baseline.area_mm2
    # the remedy of the note
    note = press.notes["contact area"]
    remedied_mm = float(note.partition("edge_mm=")[2].split()[0])
    fine = pressed(linear, remedied_mm)
    assert "contact area" not in fine.notes
    assert fine.area_mm2 == pytest.approx(baseline.area_mm2, rel=0.1)
    # measured: 3 %, and up to 5 % between two meshes of the baseline
    middle = pressed(quadratic, 3.5)
    assert "contact area" not in middle.notes
    assert middle.area_mm2 == pytest.approx(baseline.area_mm2, rel=0.08)
