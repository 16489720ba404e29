"""Complete evaluation by one command: tasks, groups and methods over many trials, and a report."""
