"""Finite elements on tetrahedra: spaces, assembly, loads, constraints and stress."""
