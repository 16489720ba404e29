"""Signed distances, and anatomies defined by signed distances."""
