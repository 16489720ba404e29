"""A blade that cuts soft tissue."""
