"""The messages between clients and daemon: requests, events, answers, and views of runs. Every
floor above uses these types; nothing here opens a file or a device."""
