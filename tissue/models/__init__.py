"""Tissue models with one interface: bone, tooth, organ, layers under a needle, virtual wall."""
