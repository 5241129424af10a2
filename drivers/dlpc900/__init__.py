"""Two DMDs with a DLPC900 each (LightCrafter 6500, 9000 and their relatives), over USB.

`commands` and `erle` only deal with bytes, `link` carries them, `device` is one panel, `sequence`
turns frames into what a panel is sent, `display` shows them on both.
"""
