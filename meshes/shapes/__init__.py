"""Signed distances, and anatomies made of them."""
