"""Image formats that no library here writes byte for byte as a run folder promises."""
