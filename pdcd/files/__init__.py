"""Files: files of others are opened with checked rights and read with limits, our own are written
whole or not at all.
"""
