"""Pictures as files: what a run folder shows, and what is exported from it."""
