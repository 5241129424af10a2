"""Requests that mean harm, over all parameters and all kinds of files; seeded.

`files` makes the content and the kinds of files, `requests` the requests, `trial` puts them to a
daemon's methods with a real engine. ``python -m tests.hostile --count 10000`` prints what came of
it.
"""

from __future__ import annotations
