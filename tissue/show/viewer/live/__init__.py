"""The window of `tissue run --live`."""
