"""Hyperelastic law of a scene's organ, and the mesh on which it is solved.

At small strains it equals the linear law.
"""

from typing import TYPE_CHECKING

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import Progress
from tissue.materials.hyperelasticity import Hyperelastic
from tissue.scene.named_parts import shown
from tissue.scene.organ import Organ, SoftAnatomy
from tissue.scene.scene import Scene
from tissue.simulation.builders.device import opens_device
from tissue.simulation.builders.organ import HeldMesh, elasticity_of, held_mesh

if TYPE_CHECKING:
    from tissue.models.organ.soft_organ import OrganLaw

__all__ = ["coarser_mesh", "hindrance", "law_of", "organ_law"]

NOT_WITH = ("capsule", "gravity", "viscous", "fibre_direction")
"""Keys of an organ that a hyperelastic law does not support yet."""
SHAPE = {"mooney-rivlin": "second_share", "yeoh": "square_ratio", "ogden": "exponent"}
"""Key that each law needs in addition to the modulus and Poisson's ratio.

None of these values is cited for an organ.
"""


def hindrance(organ: Organ) -> str | None:
    """Return the first key of an organ that no hyperelastic law supports yet; None without one."""
    if organ.path != "condensed":
        return "path"
    return next((name for name in NOT_WITH if getattr(organ, name)), None)


def law_of(organ: Organ, lame_Pa: Array) -> tuple[Hyperelastic, Array] | None:
    """Return the law of the first cell, and factors of its moduli in each cell, shape (m,).

    None is returned for the linear law.

    Parameters
    ----------
    organ
        Organ parameters of the scene.
    lame_Pa
        Lame constants of small strains [Pa], shape (m, 2), in one proportion, as `elasticity_of`
        gives them.

    Raises
    ------
    InputError
        If the scene requests something that the law does not support, or does not state a parameter
        that the law needs.
    """
    if organ.law == "linear":
        return None
    if name := hindrance(organ):
        raise InputError(
            f"organ.law and organ.{name}",
            "be left out together",
            f"{organ.law} and {shown(getattr(organ, name))}",
            (
                "remove one, a law of large strains has an isotropic elastic organ without "
                "weight, on its condensed compliance"
            ),
        )
    first, shear = lame_Pa[0].tolist()
    bulk = first + 2.0 / 3.0 * shear
    return _law(organ, shear, bulk), np.asarray(lame_Pa[:, 1] / shear)


def coarser_mesh(
    scene: Scene, *, path_m: Array, touch_edge_m: float, ratio: float, report: Progress
) -> HeldMesh:
    """Mesh a scene's organ with edges longer by a ratio; other arguments as for `held_mesh`.

    A nodule needs cells as short as the scene's. Tetrahedra from a file are not made coarser away
    from the tool.
    """
    anatomy = scene.anatomy
    assert isinstance(anatomy, SoftAnatomy)
    edge_mm = anatomy.edge_mm * (1.0 if anatomy.nodule_mm else ratio)
    # The key must not count as set: tetrahedra from a file have their own edges.
    given = anatomy.model_fields_set - {"edge_mm"}
    coarse = type(anatomy).model_construct(given, **(dict(anatomy) | {"edge_mm": edge_mm}))
    return held_mesh(coarse, path_m=path_m, touch_edge_m=ratio * touch_edge_m, report=report)


def organ_law(
    scene: Scene,
    lame_Pa: Array,
    *,
    path_m: Array,
    touch_edge_m: float,
    compute: str,
    report: Progress,
) -> "OrganLaw | None":
    """Return the law of a scene's organ and its mesh; None for the linear law.

    Parameters
    ----------
    scene
        The scene.
    lame_Pa
        Lame constants of the cells of the organ's mesh [Pa], shape (m, 2).
    path_m, touch_edge_m, report
        As for `held_mesh`.
    compute
        Warp device name.

    Raises
    ------
    InputError
        As for `law_of`, or if a real device would wait for the law.
    """
    from tissue.models.organ.soft_organ import OrganLaw, SoftOrgan

    organ = scene.organ
    found = law_of(organ, lame_Pa)
    if found is None:
        return None
    if opens_device(scene):
        raise InputError(
            "device and organ.law",
            "be left out together",
            f"{scene.held.kind} and {organ.law}",
            (
                "remove one, a real device would wait where solving the law takes longer than "
                "its interval"
            ),
        )
    law, factors = found
    interval_s = 1e-3 * organ.law_interval_ms
    if organ.law_edge_ratio == 1.0:
        return OrganLaw(law, factors, interval_s)
    mesh = coarser_mesh(
        scene, path_m=path_m, touch_edge_m=touch_edge_m, ratio=organ.law_edge_ratio, report=report
    )
    assert isinstance(scene.anatomy, SoftAnatomy)
    moduli, _ = elasticity_of(mesh.mesh, scene.anatomy, organ, scene.constants)
    coarser = SoftOrgan(mesh.mesh, moduli, mesh.held, order=organ.order, device=compute)
    return OrganLaw(law, factors, interval_s, (coarser, moduli[:, 1] / law.shear_Pa))


def _law(organ: Organ, shear_Pa: float, bulk_Pa: float) -> Hyperelastic:
    if organ.law == "neo-hookean":
        return Hyperelastic.neo_hookean(shear_Pa, bulk_Pa=bulk_Pa)
    if organ.law == "mooney-rivlin" and (share := organ.second_share) is not None:
        return Hyperelastic.mooney_rivlin(
            0.5 * (1.0 - share) * shear_Pa, 0.5 * share * shear_Pa, bulk_Pa=bulk_Pa
        )
    if organ.law == "yeoh" and organ.square_ratio is not None:
        first = 0.5 * shear_Pa
        return Hyperelastic.yeoh(
            first, organ.square_ratio * first, organ.cube_ratio * first, bulk_Pa=bulk_Pa
        )
    if organ.law == "ogden" and organ.exponent is not None:
        return Hyperelastic(bulk_Pa, ((shear_Pa, organ.exponent),))
    raise InputError(
        f"organ.{SHAPE[organ.law]}", f"be given with organ.law = {organ.law}", "none", "state it"
    )
