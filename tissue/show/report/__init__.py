"""A run as one HTML file to hand over: figures, forces, the bone or organ in 3D over time,
materials, scene.
"""
