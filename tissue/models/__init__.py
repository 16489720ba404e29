"""Tissue models with one interface: bone, tooth, organ, tissue under a needle, virtual wall."""
