"""Statistics of a study: metrics of a trial, table of trials, hypothesis tests and intervals."""
