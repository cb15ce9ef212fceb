"""What the kernel has accepted from a socket's owner but not passed on."""

from __future__ import annotations

import fcntl
import socket
import struct
import sys
import termios


def unsent_bytes(sender: socket.socket) -> int:
    """Number of bytes in the send buffer of a socket. Only Linux reports it; elsewhere 0.

    Of a TCP socket these are the bytes that the peer's kernel has not acknowledged, sent or unsent; of a UDP
    socket those that no interface has accepted.
    """
    if sys.platform != "linux":
        return 0
    # On Linux SIOCOUTQ and TIOCOUTQ have the same number.
    return int(struct.unpack("i", fcntl.ioctl(sender, termios.TIOCOUTQ, b"\0" * 4))[0])
