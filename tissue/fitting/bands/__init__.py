"""Bands of a run over the ranges of its constants, and which constant matters."""
