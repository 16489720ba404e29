"""A needle through layers of soft tissue."""
