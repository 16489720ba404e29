"""The simulation loop, its run, trace and run folder."""
