"""`pdcd init`: from what a machine has to the files of a bench."""
