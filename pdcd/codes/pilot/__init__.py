"""What a few photos of single codes tell of a scene: which far cells are linked by sharp paths, and
whether it pays to keep these apart.
"""
