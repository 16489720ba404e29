"""Links by which other programs see a run while it goes on: 3D Slicer by OpenIGTLink, ROS 2 by
CRTK names.
"""
