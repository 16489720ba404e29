"""Stability atlas: regions where a method fails, one page each."""
