"""The two errors that users or peers cause. Every other exception is a bug in this program."""


class ConfigError(Exception):
    """The configuration is wrong. The message names the key or file, its value and what is allowed."""


class PeerDataError(Exception):
    """A peer sent bytes that break its protocol: names the field or offset. Never fatal in flight."""
