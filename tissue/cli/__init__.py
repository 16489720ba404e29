"""The ``tissue`` command, one file a command."""
