"""Small wrong changes of the program, made one at a time: do the tests notice? `make mutants`."""
