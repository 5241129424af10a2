"""The version of the program; it is here so that no module has to import the package itself."""

__version__ = "1.0.0"
