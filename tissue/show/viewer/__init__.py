"""The window of `tissue view`, its screenshots and movies."""
