"""One job on one rig: the devices in order, shot after shot, failing closed; then the pictures and
the finished folder.
"""
