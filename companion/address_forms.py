"""Forms of the addresses in a configuration, such as "tcp:HOST:PORT"."""

from __future__ import annotations

import os

from companion.errors import ConfigError

LINK_FORMS = ("udpin:HOST:PORT", "udpout:HOST:PORT", "tcp:HOST:PORT", "serial:DEVICE:BAUD")
_NUMBERS = {"PORT": range(1, 1 << 16), "BAUD": range(1, 10**9), "NUMBER": range(0xFFFF)}


def check_form(text: str, forms: tuple[str, ...], name: str) -> None:
    """Check that a text has one of several forms.

    Args:
        forms: each ends with a colon and one of the words PORT, BAUD and NUMBER.
        name: file and key, for messages.

    Raises:
        ConfigError: names the key, the text and the forms that are allowed.
    """
    if not any(_has_form(text, form) for form in forms):
        allowed = " or ".join((", ".join(forms[:-1]), forms[-1])) if len(forms) > 1 else forms[0]
        raise ConfigError(f"{name}: {text!r}: allowed: {allowed}; PORT is 1 to 65535")


def used_by(text: str) -> str | None:
    """The device or address of a link or channel, in one form; None if it is any free port.

    Names of hosts are not resolved, except "localhost", and links to devices are not followed.
    """
    kind, _, rest = text.partition(":")
    where, _, number = rest.rpartition(":")
    if kind in ("serial", "uart"):
        return f"device {os.path.normpath(where)}"
    host = where.strip("[]").lower()
    # Connecting to 0.0.0.0 leads to this computer; listening there is another matter.
    local = ("localhost",) if kind == "udpin" else ("localhost", "0.0.0.0")
    return f"{kind} {'127.0.0.1' if host in local else host}:{int(number)}" if int(number) else None


def _has_form(text: str, form: str) -> bool:
    start, _, number = text.rpartition(":")
    head, _, word = form.rpartition(":")
    kind = head.removesuffix("HOST").removesuffix("DEVICE")
    fits = start == head if kind == head else start.startswith(kind) and len(start) > len(kind)
    if not (fits and number.isascii() and number.isdigit() and len(number) < 10):
        return False
    # Listening on port 0 uses any free port.
    return int(number) in _NUMBERS[word] or (kind == "udpin:" and int(number) == 0)
