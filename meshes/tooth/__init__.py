"""Teeth: procedural, from layered surfaces, or from label images."""
