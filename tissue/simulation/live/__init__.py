"""A run against the wall clock."""
