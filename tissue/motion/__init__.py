"""What moves a tool: paths, thrust, recorded poses; rotations."""
