"""Statistics of a study: metrics of a trial, the table of trials, and tests that say what they rest on."""
