"""A procedural lumbar vertebra."""
