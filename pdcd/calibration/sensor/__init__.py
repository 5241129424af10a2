"""The sensor: black, gain, read noise, linearity, saturation."""
