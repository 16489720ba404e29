"""Tissue models, all of one contract: bone, tooth, organ, needle in layers, wall."""
