"""Pictures, the viewer and the HTML report of a run."""
