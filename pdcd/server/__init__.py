"""The daemon: a JSON-RPC socket in front of one engine. See `docs/protocol.md`."""
