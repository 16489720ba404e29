"""The ``tissue`` command; each subcommand has a file of its own."""
