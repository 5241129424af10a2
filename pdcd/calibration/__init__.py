"""What a bench finds out about itself with its own camera: patterns, estimates, figures.

Everything here is pure: pictures go in, figures come out. What takes the photos is elsewhere.
"""
