"""Still pictures of a run."""
