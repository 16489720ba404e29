"""Statistics of a study: metrics of a trial, the table of trials, and tests with assumptions."""
