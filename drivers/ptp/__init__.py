"""Canon EOS cameras by PTP, the picture transfer protocol (ISO 15740).

`codes`, `containers`, `datasets` and `events` are the wire format alone: pure functions on bytes,
shared with the virtual camera.
"""
