"""Signed distances, polylines, and anatomies made of them."""
