"""Where the pixels of projector, mask and camera lie on the one field that all three look at."""
