"""Contrasts, light of the room, and how bright one unit is."""
