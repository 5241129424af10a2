"""What clients and daemon say to each other: requests, events, messages, and views of runs. Every
floor above speaks these types; nothing here opens a file or a device.
"""
