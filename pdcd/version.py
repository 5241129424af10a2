"""The version of the program; it lies here so that no room has to import the package's own door."""

__version__ = "1.0.0"
