"""The description of one bench: its configuration file, the interfaces of drivers and the table of
those there are, the clock, and the findings of a doctor. Nothing here moves a device or computes
with light."""
