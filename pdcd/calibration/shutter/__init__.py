"""When the shutter really opens and closes."""
