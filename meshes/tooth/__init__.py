"""Teeth: procedural, from layered surfaces, from label images."""
