"""Meshes of soft organs, generated procedurally or from label images."""
