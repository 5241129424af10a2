"""One bench as written down: the configuration file, what a driver must offer and which drivers
there are, the clock, what a doctor finds. It moves no device and knows no light.
"""
