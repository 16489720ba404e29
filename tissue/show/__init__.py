"""Pictures, viewer and HTML report of a run."""
