"""Solvers of the linear system: direct, multigrid, and compliances of the surface."""
