"""Public classes and functions of `tissue`, such as `Bone`, `Loop` and `simulate`."""
