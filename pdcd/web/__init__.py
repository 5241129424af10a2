"""`pdcd web`: a page on the loopback interface for the person at the bench.

It is a client of the daemon's socket like any other, with the rights of the user who started it,
and reads runs from the state folder. It needs aiohttp, of the extra "web".
"""
