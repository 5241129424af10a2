"""`pdcd virtual-camera`: a camera on the network that other programs can drive."""

from __future__ import annotations

import argparse

from pdcd.bench.registry import own_module
from pdcd.cli.exits import DONE
from pdcd.cli.output import say
from pdcd.errors import ConfigError

MOST_PORT = 65535


def virtual_camera(args: argparse.Namespace) -> int:
    """Serve the virtual camera until interrupted. Raises ConfigError for a port out of range."""
    if not 0 <= args.port <= MOST_PORT:
        raise ConfigError(f"--port {args.port} is not between 0 and {MOST_PORT}")
    # By name, as it loads drivers: pdcd imports none of them.
    command = own_module("virtual_camera.command")
    try:
        command.serve(args.port, scene=args.scene, small=args.small, say=say)
    except KeyboardInterrupt:
        return DONE  # that is how it ends
    return DONE
