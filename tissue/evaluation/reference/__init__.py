"""Reference of the cutting force on exact geometry, which shares no voxel and no element with
the engine.
"""
