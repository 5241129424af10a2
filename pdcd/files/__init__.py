"""Files: those of others opened with rights and read with limits, ours written whole or not at
all.
"""
