"""Benches drawn by chance, with a truth the program does not know: calibrated and compared."""
