"""The virtual bench: scenes with known light transport, and the optics that look at them."""
