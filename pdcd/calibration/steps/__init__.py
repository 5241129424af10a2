"""The steps of a calibration, each a script (`pdcd.calibration.script`), by name."""
