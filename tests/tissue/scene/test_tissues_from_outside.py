"""Tables of parts that accept tools, motions and tissues from outside.

A scene names one and runs with it.
"""

from dataclasses import replace

import numpy as np
import pytest

from tissue import InputError, Scene, load_scene, simulate
from tissue.cutters.profile import cylinder
from tissue.models.needle.parameters import needle_tissue
from tissue.models.organ.probe import SphereProbe
from tissue.scene.registry import CUTTERS, NEEDLES, PROBES, CutterEntry, ProbeEntry


def test_a_cutter_from_outside_cuts(added):
    """A cutter from outside cuts.

    It is a cylinder by another name, half as wide: it removes less than its namesake and reads a
    length.
    """
    half = lambda diameter_m, length_m: cylinder(diameter_m=0.5 * diameter_m, length_m=length_m)  # noqa: E731
    added(CUTTERS, "half-cylinder", CutterEntry(half, ("length_mm",)))
    changes = {"voxels.spacing_mm": 0.5, "duration_s": 0.5, "tool.length_mm": 5.0}
    changes |= {"tool.diameter_mm": 6.0, "tool.spin_rpm": 500.0}
    thin, thick = (
        simulate(load_scene("milling", changes | {"tool.kind": kind}))
        for kind in ("half-cylinder", "cylinder")
    )
    assert 0.0 < thin.trace["removed_mm3"][-1] < 0.7 * thick.trace["removed_mm3"][-1]
    assert Scene.model_validate(thin.scene.model_dump()).tool.kind == "half-cylinder"
    with pytest.raises(
        InputError,
        match=r"tool.kind must be one of ball-burr, .*, half-cylinder, .*, got half-cylindr \(did",
    ):
        load_scene("milling", {"tool.kind": "half-cylindr"})
    with pytest.raises(
        InputError, match=r"tool.point_angle_deg must be left out for a half-cylinder\. Set"
    ):
        load_scene(
            "milling", changes | {"tool.kind": "half-cylinder", "tool.point_angle_deg": 90.0}
        )
    with pytest.raises(
        InputError, match=r"^tool.length_mm must be greater than 0 and at most 200, got -1"
    ):
        load_scene("milling", changes | {"tool.kind": "half-cylinder", "tool.length_mm": -1.0})


SLAB = {
    "anatomy.kind": "slab",
    "anatomy.size_mm": [60.0, 60.0, 20.0],
    "anatomy.edge_mm": 10.0,
    "anatomy.nodule_diameter_mm": 0.0,
    "organ.order": 1,
    "organ.interval_ms": 0.0,
    "device": "none",
    "motion.points_mm": [[0, 0, 1], [0, 0, -2]],
    "duration_s": 0.15,
    "tool.diameter_mm": 20.0,
}


def test_a_probe_from_outside_presses(added):
    """A ball of twice the stated diameter is the ball of that diameter."""
    added(
        PROBES,
        "wide-ball",
        ProbeEntry(lambda tool: SphereProbe(1e-3 * tool.diameter_mm), ("diameter_mm",)),
    )
    touch = {"anatomy.touch_edge_mm": 5.0, "motion.feed_mm_s": 20.0}
    wide, same, half = (
        simulate(
            load_scene(
                "palpation", SLAB | touch | {"tool.kind": kind, "tool.diameter_mm": diameter_mm}
            )
        )
        for kind, diameter_mm in (
            ("wide-ball", 20.0),
            ("sphere-probe", 40.0),
            ("sphere-probe", 20.0),
        )
    )
    assert wide.trace["model_force_z_N"].max() > 1.1 * half.trace["model_force_z_N"].max() > 0.01
    np.testing.assert_array_equal(wide.trace["model_force_z_N"], same.trace["model_force_z_N"])
    for changes, refusal in (
        (
            {"tool.kind": "wide-bal"},
            r"^tool.kind must be one of ball-burr, .*, wide-ball, needle or blade, got wide-bal \(did",
        ),
        (
            {"tool.kind": "wide-ball", "tool.length_mm": 5.0},
            r"^tool.length_mm must be left out for a wide-ball\. Set",
        ),
        (
            {"tool.kind": "wide-ball", "tool.file": "a.stl"},
            r"^tool.file must be left out for a wide-ball\. Set",
        ),
    ):
        with pytest.raises(InputError, match=refusal):
            load_scene("palpation", SLAB | {"tool.diameter_mm": 20.0} | changes)


def test_a_needle_from_outside_pierces(added):
    """One that cuts twice as hard is held back more once it is in."""
    added(NEEDLES, "blunt", lambda walls: replace(needle_tissue(), cutting_N=5.0))
    blunt, sharp = (
        simulate(
            load_scene(
                "needle",
                {
                    "tool.kind": kind,
                    "anatomy.interval_ms": 0.0,
                    "device": "none",
                    "duration_s": 2.0,
                },
            )
        )
        for kind in ("blunt", "needle")
    )
    assert blunt.trace["model_force_z_N"].max() > 1.5 * sharp.trace["model_force_z_N"].max() > 0.5
    with pytest.raises(
        InputError,
        match=r"^tool.kind must be needle or blunt for anatomy.kind = layers, got sphere-pr",
    ):
        load_scene("needle", {"tool.kind": "sphere-probe"})
