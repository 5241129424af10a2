"""The display process: two real panels in lockstep on one X screen.

It is a process of its own, never a thread of the daemon: a busy thread beside the loop would make
it miss most of its frames. A driver uses `client`; `process` runs on the other side.

=============  =====================================================================
`client`       starts, commands, watches and kills the process
`messages`     the messages between the two, and the memory they share
`process`      opens the panels, answers messages
`loop`         shows rows one vblank after the other and logs them
`clocks`       which vblank it was: time sources from best to worst, and their probe
`phase`        phase between the vblanks of both outputs
`places`       where the panels lie on the screen, and whether they still do
`outputs`      the outputs of the graphics card, and who their panels say they are: `edid`
`windows`      X windows and GL: layouts, one draw for each panel and refresh
`viewport`     which panel pixels a code cell covers
`xgrab`        what the X server holds for both panels
`realtime`     scheduling class, locked memory, garbage collector
=============  =====================================================================
"""
