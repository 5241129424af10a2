"""`pdcd init`: from the devices of a machine to the files of a bench."""
