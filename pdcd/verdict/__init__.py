"""Whether a photo can be used: figures of its pictures are compared with limits, and sentences say
what was found.
"""
