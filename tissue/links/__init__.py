"""Connections to other programs during a run: 3D Slicer (OpenIGTLink) and ROS 2 (CRTK names)."""
