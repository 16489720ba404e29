"""Anatomies of teeth: procedural, from one surface per layer, or from label images."""
