"""What drivers of any package are tested with: each promise of `pdcd.driver`'s roles, as pytest.

::

    from pdcd.testing import ShutterContract

    class TestAcmeShutter(ShutterContract):
        config = {"trigger": {"driver": "acme", "options": {"port": "loop://"}}}

`config` holds the tables of a configuration file, or names one; what it leaves out is the mock
bench. Where a driver needs more (a fake device at the other end, a folder), override the fixture
`rig`: take `make_rig`, connect the devices, yield the rig, and disconnect it.

`ShutterContract`, `DisplayContract`, `ReadoutContract`, `PreviewContract`
    One class a role. A test that fails raises `BrokenPromise`: which promise, what was found, what
    to do.
`ShutterContract.find_open`, `DisplayContract.find_lit`
    To be overridden where a fake device tells whether it is open, or lit: only then it is looked
    at whether a shutter believed closed is closed, and panels believed black are black.
`make_rig`
    The devices of a configuration on one clock.

Nothing else of pdcd needs pytest, and nothing of pdcd imports from here.
"""

from pdcd.testing.display import DisplayContract
from pdcd.testing.preview import PreviewContract
from pdcd.testing.promises import BrokenPromise, Promise
from pdcd.testing.readout import ReadoutContract
from pdcd.testing.rigs import make_rig
from pdcd.testing.shutter import ShutterContract

__all__ = [
    "BrokenPromise",
    "DisplayContract",
    "PreviewContract",
    "Promise",
    "ReadoutContract",
    "ShutterContract",
    "make_rig",
]
