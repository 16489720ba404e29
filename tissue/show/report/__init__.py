"""Report on a run as one HTML file: figures, forces, 3D view over time, materials, scene."""
