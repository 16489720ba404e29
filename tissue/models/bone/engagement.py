"""Loads on a cutter for any cutting law, stored at nodes of density and nodes of chip thickness.

Every coefficient of a cutting element is multiplied by (density / reference) ** exponent. The sum
f(p) = sum w rho**p over elements of density rho and weight w is therefore needed for any exponent
p. Let c be the middle of the range of exponents. The factor rho**(p - c) is interpolated by
polynomials L_j of ln rho. The nodes rho_j are Chebyshev points of ln rho. Then::

    f(p) = sum_j rho_j**(p - c) M_j,    M_j = sum w rho**c L_j(ln rho)

The interpolation of exp(a x) on [-1, 1] by n points has an error of about 4 I_n(a), with the
modified Bessel function I_n (Trefethen 2013, Approximation Theory and Approximation Practice, ch.
3). n is the smallest number of points whose error is below `ERROR` times the smallest value,
exp(-a).

The force per length of edge depends on the chip thickness. This force is interpolated linearly
between the nodes of chip thickness. The interpolation is exact for a law that is linear in the
thickness.
"""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.special import iv

from kernels.engagement import DENSITIES, DENSITY, DISTANCE, LAYER, WIDTH
from meshes.base.arrays import Array, Ints
from tissue.cutters.cutter import Cutter
from tissue.materials.constants import effective_chip
from tissue.models.bone.elements import edge_lengths_m, levers_of
from tissue.models.bone.law_limits import THICKEST_M
from tissue.models.bone.model import BoneModel, MilledTissue
from tissue.models.tissue_model import Response, ToolMotion

HIGHEST_EXPONENT = 5.0
"""Largest density exponent that a scene accepts; the smallest is 0."""
MIDDLE = 0.5 * HIGHEST_EXPONENT
"""Middle c of the range of density exponents p; it minimises the largest magnitude of p - c."""
ERROR = 1e-8
"""Largest relative error of an element's interpolated density factor.

Loads that are recomputed from stored nodes may have an error of a hundred times this value.
"""
MOST_NODES = 64
"""Upper limit of the number of nodes; densities of 1 to 20,000 kg/m3 need 38 nodes."""


@dataclass(frozen=True, eq=False)
class DensityNodes:
    """Interpolation nodes over the density range of one layer.

    Attributes
    ----------
    densities_kg_m3
        Densities of the nodes [kg/m3], shape (k,).
    shares
        Weights with which an element contributes to each node, shape (DENSITIES, k). The row index
        is the element's density rho [kg/m3]. The weight of node j is (rho / `middle_kg_m3`) ** c
        times the polynomial L_j(ln rho); the module defines c and L_j.
    """

    densities_kg_m3: Array
    shares: Array

    @classmethod
    def of(cls, least_kg_m3: int, most_kg_m3: int) -> "DensityNodes":
        """Return the nodes for a range of densities; one node if the range is a single density."""
        # At least 1, because zero has no logarithm.
        least, most = (min(max(each, 1), DENSITIES - 1) for each in (least_kg_m3, most_kg_m3))
        if least == most:
            return cls(np.array([float(least)]), np.ones((DENSITIES, 1)))
        middle = 0.5 * np.log(most * least)
        half = 0.5 * np.log(most / least)
        count = _count(MIDDLE * half)
        at = np.cos(np.pi * (np.arange(count) + 0.5) / count)
        density = np.clip(np.arange(DENSITIES), least, most)
        x = (np.log(density) - middle) / half
        modes = chebvander(at, count - 1)
        # The first Chebyshev coefficient is a mean, the others are twice a mean.
        modes[:, 1:] *= 2.0
        polynomials = chebvander(np.clip(x, -1.0, 1.0), count - 1) @ modes.T / count
        return cls(np.exp(middle + half * at), polynomials * (np.exp(half * x) ** MIDDLE)[:, None])

    @property
    def middle_kg_m3(self) -> float:
        """Geometric mean of the smallest and largest density of the range [kg/m3]."""
        return float(np.exp(np.log(self.densities_kg_m3).mean()))

    def strengths(self, exponent: float, *, reference_kg_m3: float, factor: float = 1.0) -> Array:
        """Return the weights of the nodes that represent a density exponent, shape (k,).

        For each density, `shares` @ weights is (factor * density / reference) ** exponent.
        """
        tilt = (self.densities_kg_m3 / self.middle_kg_m3) ** -MIDDLE
        return (factor * self.densities_kg_m3 / reference_kg_m3) ** exponent * tilt

    def logarithms(self, *, reference_kg_m3: float, factor: float = 1.0) -> Array:
        """Return ln(factor * density / reference) at the nodes, shape (k,).

        The derivative of the strength with respect to the exponent contains this logarithm as a
        factor.
        """
        return np.log(factor * self.densities_kg_m3 / reference_kg_m3)


def _count(a: float) -> int:
    """Return the number of points needed to interpolate exp(a x) on [-1, 1].

    The error of the interpolation is at most `ERROR` times the smallest value of exp(a x).
    """
    counts = np.arange(2, MOST_NODES)
    return int(counts[np.argmax(4.0 * iv(counts, a) * np.exp(a) < ERROR)])


def densities_of(material: NDArray[np.uint32], layer: int) -> Ints:
    """Return the smallest and largest density in a layer of stored voxels [kg/m3].

    `material` holds one packed word for each voxel, see `BrickStore.material`. Both densities are
    zero if no voxel of the layer has a density.
    """
    density = (material[(material & 255) == layer] >> 16).astype(np.int64)
    density = density[density > 0]
    return np.array([density.min(), density.max()]) if len(density) else np.zeros(2, np.int64)


DIRECTIONS = 3
"""Number of directions of the loads on an element: tangential, radial and axial."""
CHIP_RATIO = 1.3
"""Ratio between neighbouring nodes of chip thickness.

For a force proportional to the thickness to the power 1 - m, the relative error of the
interpolation is at most m (1 - m) ln(ratio) ** 2 / 8. For m = 0.5 this bound is 0.2 %.
"""
THINNEST = 1e-3
"""Smallest nonzero node of chip thickness, divided by the largest node; chosen.

Below this node, forces are interpolated linearly down to a thickness of zero.
"""


LINEAR_CHIPS_M = np.array([0.0, THICKEST_M])
"""Nodes of chip thickness [m] for a linear law. Interpolation between two nodes is exact."""


def chip_nodes(thickest_m: float) -> Array:
    """Return interpolation nodes for chip thicknesses [m] up to the thickest chip, shape (k,)."""
    count = int(np.ceil(np.log(1.0 / THINNEST) / np.log(CHIP_RATIO))) + 1
    return np.concatenate([[0.0], thickest_m * np.geomspace(THINNEST, 1.0, count)])


def _interpolation(nodes_m: Array, thickness_m: Array, lengths: Array) -> csr_array:
    """Return the matrix that distributes n chips to k nodes of chip thickness, shape (k, n).

    The column of a chip is multiplied by the length of the chip's cutting edge. Chips thicker than
    the last node are extrapolated.
    """
    upper = np.clip(np.searchsorted(nodes_m, thickness_m), 1, len(nodes_m) - 1)
    lower = upper - 1
    share = (thickness_m - nodes_m[lower]) / (nodes_m[upper] - nodes_m[lower])
    elements = np.arange(len(thickness_m))
    values = np.concatenate([(1.0 - share) * lengths, share * lengths])
    places = np.concatenate([lower, upper]), np.concatenate([elements, elements])
    return csr_array((values, places), shape=(len(nodes_m), len(thickness_m)))


class EngagedElements:
    """Search for cutting elements in contact with bone, and for the bone in front of them.

    Parameters
    ----------
    bone
        Model of the bone and of the cutter.
    """

    def __init__(self, bone: BoneModel) -> None:
        self.bone = bone
        self.edges_m = edge_lengths_m(bone.shell, bone.cutter)
        """Length of cutting edge in each element [m], shape (n,)."""

    def find(self, motion: ToolMotion) -> tuple[Array, ...]:
        """Return engaged share, advance divided by speed, layer and density of each element.

        Each array has a value for every element. The engaged share is the fraction of an element
        that lies in bone. The advance is the motion along the element's outward normal.
        """
        shell = self.bone.shell
        found = self.bone.found_along(motion)[:, : len(shell.radii_m)]
        distance, width = found[DISTANCE].astype(np.float64), found[WIDTH].astype(np.float64)
        velocity, turning = motion.heading @ motion.rotation
        advance = (velocity + np.cross(turning, shell.points_m)) * shell.normals
        met = width > 0.0
        share = np.zeros(len(width))
        share[met] = np.clip(0.5 - distance[met] / width[met], 0.0, 1.0)
        return share, advance.sum(axis=1), found[LAYER].astype(int), found[DENSITY].astype(int)

    def cutting(self, motion: ToolMotion) -> tuple[Array, Array, Array]:
        """Return points where the cutter cuts, their outward normals and relative cutting powers.

        Points [m] are in the world frame. The relative power of an element is its tangential force
        times its distance from the axis. The spin is left out, because it is a common factor.
        """
        share, advance, layer, density = self.find(motion)
        met = np.flatnonzero(share)
        shell = self.bone.shell
        cutter = self.bone.cutter
        chip, edge, reference, exponent, *size = np.array(
            [
                [
                    each.tangential_chip_Pa,
                    each.tangential_edge_N_m,
                    each.reference_density_kg_m3,
                    each.density_exponent,
                    each.size_exponent,
                    each.minimum_chip_m,
                    each.reference_chip_m,
                ]
                for each in self.bone.coefficients
            ]
        )[layer[met]].T
        thickness = cutter.chip_per_speed_s * motion.speed_m_s * advance[met].astype(np.float64)
        effective, of_edge = effective_chip(thickness, *size)
        strength = (density[met] / reference) ** exponent
        powers = (
            shell.radii_m[met]
            * cutter.load_factors(shell.radii_m[met])[:, 0]
            * self.edges_m[met]
            * share[met]
            * strength
            * (chip * effective + edge * of_edge)
        )
        points = motion.tip_m + shell.points_m[met] @ motion.rotation.T
        return points, shell.normals[met] @ motion.rotation.T, powers


class EngagedBone(MilledTissue):
    """Bone model that computes unit loads on the tool instead of the cutting force.

    A unit load is the load on the tool from a force of 1 N per metre of cutting edge. The unit
    loads determine the cutting force for any cutting law.

    Parameters
    ----------
    bone
        The bone model that removes bone. The cutting coefficients of this model are not used.
    chips_m
        Interpolation nodes of the chip thickness [m], shape (k,), see `chip_nodes`.

    Attributes
    ----------
    nodes
        Density nodes of each layer. `unit_loads` are computed at these nodes.
    unit_loads
        Array of shape (nodes, 3 k, 6) for each layer, computed in the last call of `respond`. A row
        holds the force [N] and the torque about the tip [N m] on the tool, in the world frame.
        There is a row for each combination of density node, chip-thickness node and direction in
        `DIRECTIONS`. `DensityNodes.strengths` returns the weights of the nodes for a density
        exponent.
    computes_loads
        True if `respond` computes `unit_loads`.
    """

    def __init__(self, bone: BoneModel, chips_m: Array) -> None:
        super().__init__(bone)
        self.chips_m = chips_m
        self.measure_names: tuple[str, ...] = ()
        self.computes_loads = True
        material = bone.store.material.numpy()
        self.nodes = [
            DensityNodes.of(*densities_of(material, layer))
            for layer in range(len(self.layer_names))
        ]
        self.unit_loads = [
            np.zeros((len(each.densities_kg_m3), DIRECTIONS * len(chips_m), 6))
            for each in self.nodes
        ]
        self._response = Response.empty(len(self.layer_names))
        self.engaged_m2 = self._response.engaged_m2
        """Area of the tool in contact with each layer in the last `respond` [m2], (layers,)."""
        self._levers = levers_of(bone.shell, bone.cutter)
        self._elements = EngagedElements(bone)

    def respond(self, motion: ToolMotion) -> Response:
        """Return a response with the tool area in bone, the removal rate, and zero force.

        `unit_loads` are computed at the motion's speed.
        """
        response = self._response
        if not self.computes_loads:
            return response
        share, advance, layer, density = self._elements.find(motion)
        met = np.flatnonzero(share)
        engaged = self.milling.shell.areas_m2[met] * share[met]
        lengths = self._elements.edges_m[met] * share[met]
        speeds = advance[met].astype(np.float64)
        layers = layer[met]
        response.engaged_m2[:] = np.bincount(layers, engaged, minlength=len(self.layer_names))
        response.removal_rate_m3_s = float(engaged @ speeds) * motion.speed_m_s
        chip = self.milling.cutter.chip_per_speed_s * motion.speed_m_s * speeds
        # A tool at rest is loaded by a share of its edge force.
        pressed = 1.0 if motion.speed_m_s > 0.0 else motion.pressed
        levers = self._levers[met]
        for at, nodes in enumerate(self.nodes):
            here = layers == at
            weights = _interpolation(self.chips_m, chip[here], -pressed * lengths[here])
            self.unit_loads[at][:] = _sums(
                weights, levers[here], nodes.shares[density[met][here]], motion
            )
        return response


def _sums(weights: csr_array, levers: Array, shares: Array, motion: ToolMotion) -> Array:
    """Return the loads on cutting elements, summed for each density node, shape (nodes, 3 k, 6).

    `weights` is the matrix of `_interpolation` for the n elements, shape (k, n). `levers` is the
    result of `levers_of`, shape (n, 18). `shares` has the weights of the density nodes for each
    element, shape (n, nodes).
    """
    columns = shares[:, :, None] * levers[:, None, :]
    columns = columns.reshape(len(levers), shares.shape[1] * levers.shape[1])
    sums = (weights @ columns).reshape(weights.shape[0], shares.shape[1], DIRECTIONS, 2, 3)
    loads = (sums @ motion.rotation.T).transpose(1, 0, 2, 3, 4)
    return loads.reshape(shares.shape[1], DIRECTIONS * weights.shape[0], 6)


PLUNGE_ELEMENTS = 40_000
"""Number of cutting elements of a cutter in a plunge.

A run with a quarter of this number has a force error of 0.1 %.
"""
LEAST_ADVANCE = 1e-6
"""Advance per unit of feed below which an element of the cutter counts as not cutting."""


def plunge_unit_loads(cutter: Cutter, feeds_per_turn_m: Array) -> tuple[Array, Array]:
    """Return the steady unit loads of a fully engaged cutter that is fed along its axis, z.

    The unit loads are defined in `EngagedBone.unit_loads`.

    Parameters
    ----------
    cutter
        The cutter.
    feeds_per_turn_m
        Feeds per turn for which the unit loads are computed [m], shape (n,).

    Returns
    -------
    tuple
        Chip-thickness nodes [m], shape (k,), and unit loads at these nodes, shape (1, 3 k, n, 6),
        in the layout of `tissue.simulation.load_record.LayerLoads`. The relative density is 1.
    """
    shell = cutter.shell(spacing_m=(cutter.cutting_area_m2 / PLUNGE_ELEMENTS) ** 0.5)
    advance = -shell.normals[:, 2]
    cuts = advance > LEAST_ADVANCE
    advance = advance[cuts]
    lengths = edge_lengths_m(shell, cutter)[cuts]
    levers = levers_of(shell, cutter)[cuts]
    feeds_per_tooth_m = feeds_per_turn_m / cutter.flute_count
    chips = np.multiply.outer(feeds_per_tooth_m, advance)
    # Elements on the lips of a drill share one advance. Its chip thickness becomes a node, so that
    # the interpolation between nodes is exact there.
    advances, counts = np.unique(advance.round(12), return_counts=True)
    shared = np.multiply.outer(feeds_per_tooth_m, advances[counts > 1])
    nodes = np.unique(np.concatenate([chip_nodes(float(chips.max())), shared.ravel()]))
    motion = ToolMotion()
    shares = np.ones((len(lengths), 1))
    rows = [_sums(_interpolation(nodes, each, -lengths), levers, shares, motion) for each in chips]
    return nodes, np.stack(rows, axis=2)
