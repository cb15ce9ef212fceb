"""What an aircraft broadcasts and says, and another one that is configured differently."""

from __future__ import annotations

import msgspec

from companion.events import Say


def told(bench, kind, seconds=1.5):
    """Messages of a kind that go out in the next seconds."""
    return [
        m
        for c in bench.step(round(seconds / 0.05))
        for m in getattr(c, "messages", ())
        if isinstance(m, kind)
    ]


def said(commands):
    return [(c.severity, c.text) for c in commands if isinstance(c, Say)]


def configured(bench, **changes):
    """A fresh bench whose [remote_id] keys are replaced."""
    config = bench.core.config
    remote_id = msgspec.structs.replace(config.remote_id, **changes)
    return type(bench)(type(bench.core)(msgspec.structs.replace(config, remote_id=remote_id)))
