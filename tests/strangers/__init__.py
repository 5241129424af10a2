"""A stranger's bench, and the judge of what pdcd makes of it (`make strangers`)."""
