"""Image files: CT and micro-CT in the frame LPS [mm]."""
