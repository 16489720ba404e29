"""Tissue models with one interface: bone, tooth, organ, needle in layers, wall."""
