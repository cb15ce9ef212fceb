"""The two errors that are somebody else's; every other exception is a bug of ours."""


class ConfigError(Exception):
    """The configuration is wrong: the message names the key or file, what it holds and what is allowed."""


class PeerDataError(Exception):
    """A peer sent bytes that break its protocol: names the field or offset. Never fatal in flight."""
