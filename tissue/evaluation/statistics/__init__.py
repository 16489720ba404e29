"""Statistics of a user study: metrics, table of trials, hypothesis tests and intervals."""
