"""Window of `tissue run --live`."""
