"""Cases that are hard for arithmetic, shared by tests and bench."""
