"""Machine-vision cameras: GigE Vision and USB3 Vision of any maker, by Aravis.

`library` and `aravis` are the library, `pixels` and `levels` its samples, `device` one camera's
settings by its `features`, `camera` its exposures (`exposure`) and frames, `roles` the shutter and
the readout made of them.
"""
