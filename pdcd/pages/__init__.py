"""Pages that open from the disk, without a network."""
