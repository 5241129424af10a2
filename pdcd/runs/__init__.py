"""The run folder and what a run remembers of itself: manifest, shots, frame log, what happened."""
