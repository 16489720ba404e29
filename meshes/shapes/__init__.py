"""Basic shapes as signed distance functions, and anatomies that are built from such functions."""
