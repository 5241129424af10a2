"""What a stream costs, apart from the light that it photographs: ``python -m tests.stream_bench``.

`recorded` : photos of a stream before two virtual DMDs, made beforehand. `players` : a display that
shows them again in real time, and the camera and the mock in processes of their own. `meter` : what
it costs.
"""
