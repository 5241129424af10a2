"""The display process: two real panels in lockstep on one X screen.

It is a process of its own, never a thread of the daemon: a busy thread beside the loop would cost
most of its frames. `client` is what a driver uses; `process` is what runs on the other side.

=============  =====================================================================
`client`       starts, commands, watches and kills the process
`messages`     what the two say to each other; arrays go by `memory`
`process`      opens the panels, answers messages
`loop`         shows rows one vblank after the other and logs them
`clocks`       which vblank it was: time sources from best to worst, and their probe
`phase`        how the vblanks of both outputs lie to each other
`places`       where the panels lie on the screen, and whether they still do
`windows`      X windows and GL: layouts, one draw for each panel and refresh
`cells`        which panel pixels a code cell covers
`realtime`     scheduling class, locked memory, garbage collector
=============  =====================================================================
"""
