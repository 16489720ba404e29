"""Solvers of the linear system: direct, multigrid, condensed to the surface, reduced."""
