"""A bench of another package, with physics of its own: optics, panels, lens, noise and scenes.

It knows nothing of pdcd but `pdcd.driver` (what the devices are asked to do, and what pixels a
panel must show), and shares no formula with the mock bench: light is followed point by point on
the scene and step by step in time.

`facts` says what a bench is, `places` where its parts lie, `panels` how pixels of a panel brighten
and darken, `scene` how light travels, `world` makes photos and true pictures of all that, `drivers`
is what pdcd sees.
"""
