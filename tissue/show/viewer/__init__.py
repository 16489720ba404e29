"""Window, screenshots and movies of `tissue view`."""
