"""Simulation loop, and the run, trace and run folder that it produces."""
