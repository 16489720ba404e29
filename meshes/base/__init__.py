"""What all of geometry shares: errors, progress, cache, whole files, parsing in a child process."""
