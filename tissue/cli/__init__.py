"""The ``tissue`` command, with one module for each subcommand or group of subcommands."""
