"""Report on a run as one HTML file: key figures, forces, 3D view over time, materials, scene."""
