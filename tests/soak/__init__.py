"""A soak: a real daemon, clients that behave and clients that do not, kills, faults; for hours.

``make soak MINUTES=60`` or ``python -m tests.soak --minutes 60 --seed 1 --out REPORT``. After
each attack the promises are looked at from outside: panels black and shutter closed in time, no
folder that looks finished and is not, nothing leaked. It ends with a table, and with 1 if a promise
broke.
"""
