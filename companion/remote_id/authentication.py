"""Authentication messages (ASTM F3411-22a section 5.4.5.8): split data into pages, and put pages together.

The standard defines the pages (17 bytes of data on page 0, 23 on each of up to 15 more) and the type numbers.
Type 5 is the Specific Authentication Method, which `companion.remote_id.drip` fills with DRIP (RFC 9575). The
other types are assembled and displayed, but never verified.

One lost page can be restored (RFC 9575 section 5): after the data follow a length byte (ADL), null padding to
the end of that page, and a last page with the XOR of all pages before it. This is used on BLE 4 alone, where
each page is a frame of its own; in a pack it is forbidden (section 6.2).
"""

from __future__ import annotations

import struct
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Final

from companion.remote_id.messages import Authentication
from companion.remote_id.wire_values import utc_to_wire

SPECIFIC_METHOD: Final = 5
"""Authentication type of DRIP."""
PAGE_0_DATA: Final = 17
PAGE_DATA: Final = 23
LAST_PAGE: Final = 15
LENGTH_MAX: Final = 255
"""Largest value of the length byte, although 16 pages could hold more."""

_HEAD: Final = struct.Struct("<BBI")
"""Last page, length and timestamp, which precede the data of page 0."""


@dataclass(frozen=True, slots=True)
class AuthenticationData:
    """One Authentication assembled from its pages."""

    auth_type: int
    timestamp_utc_s: float | None
    data: bytes
    consistent: bool = True
    """Whether the frame counters show that all pages are of one set. Pages of two sets, each with losses, can
    fill one; a signature in it is then wrong without anybody's fault."""

    @property
    def page_count(self) -> int:
        """Number of pages that the data takes."""
        return _pages_for(len(self.data))


def _pages_for(size: int) -> int:
    return 1 + max(0, -(-(size - PAGE_0_DATA) // PAGE_DATA))


def split(authentication: AuthenticationData, *, parity: bool = False) -> tuple[Authentication, ...]:
    """Split the data into the pages to send, page 0 first.

    Args:
        parity: append the page from which a receiver restores one lost page (RFC 9575 section 5.1).

    Raises:
        ValueError: more than 255 bytes. So many take 13 pages of the 16 that are allowed, with parity.
    """
    data, size = authentication.data, len(authentication.data)
    if size > LENGTH_MAX:
        raise ValueError(f"authentication data of {size} bytes; allowed: up to {LENGTH_MAX}")
    count = authentication.page_count
    if parity:
        count = _pages_for(size + 1)
        padding = PAGE_0_DATA + PAGE_DATA * (count - 1) - size - 1
        data += bytes((padding + PAGE_DATA,)) + bytes(padding)
    last_page = count if parity else count - 1
    kind, stamp = authentication.auth_type, authentication.timestamp_utc_s
    first = Authentication(
        auth_type=kind,
        page=0,
        data=data[:PAGE_0_DATA],
        last_page=last_page,
        length=size,
        timestamp_utc_s=stamp,
    )
    rest = [data[PAGE_0_DATA + PAGE_DATA * k :][:PAGE_DATA] for k in range(count - 1)]
    if parity:
        rest.append(_xor([_page_0_bytes(first), *rest]))
    return first, *(Authentication(auth_type=kind, page=k, data=part) for k, part in enumerate(rest, 1))


def _page_0_bytes(head: Authentication) -> bytes:
    """The 23 payload bytes of page 0."""
    stamp = utc_to_wire("Authentication.timestamp_utc_s", head.timestamp_utc_s)
    return _HEAD.pack(head.last_page or 0, head.length or 0, stamp) + head.data.ljust(PAGE_0_DATA, b"\0")


def _xor(pages: list[bytes]) -> bytes:
    total = 0
    for page in pages:
        total ^= int.from_bytes(page.ljust(PAGE_DATA, b"\0"), "little")
    return total.to_bytes(PAGE_DATA, "little")


# ---------------------------------------------------------------- pages to data


@dataclass(slots=True)
class _PageSet:
    """Pages of one type received so far from one source.

    A page does not state which page 0 it belongs to. Pages normally arrive in order, so those received after
    a page 0 belong to it. Pages received earlier may have overtaken page 0, so they fill gaps until the same
    page arrives after it.
    """

    touched_s: float
    head: Authentication | None = None
    head_counter: int | None = None
    pages: dict[int, bytes] = field(default_factory=dict)
    early: dict[int, bytes] = field(default_factory=dict)
    counters: dict[int, int | None] = field(default_factory=dict)
    given: bool = False
    """Whether the data of this set was returned."""

    def add_page(self, page: Authentication, counter: int | None) -> bool:
        """Take in one page. Return whether an unfinished set was given up for it."""
        if page.page == 0:
            return self._take_head(page, counter)
        number, data = page.page, page.data[:PAGE_DATA].ljust(PAGE_DATA, b"\0")
        gave_up = False
        if self.head is not None and self.pages.get(number, data) != data:
            # A page that we hold arrived with new content: the next set has begun, and its page 0 was missed.
            gave_up = not self.given
            self._clear(None, None)
        if self.head is None:
            self.early[number] = data
            self.counters[number] = counter
            return gave_up
        if number <= (self.head.last_page or 0) and number not in self.pages:
            self.pages[number] = data
            self.counters[number] = counter
            self.given = self.given and self.early.get(number, data) == data
            self.early.pop(number, None)
        return gave_up

    def _take_head(self, head: Authentication, counter: int | None) -> bool:
        if head.last_page is None or head.length is None or head == self.head:
            return False
        if head.last_page > LAST_PAGE or head.length > PAGE_0_DATA + PAGE_DATA * head.last_page:
            return False
        gave_up = self.head is not None and not self.given
        early = {} if self.head is not None else self.early
        counters = {number: self.counters.get(number) for number in early}
        self._clear(head, counter)
        self.early, self.counters = early, counters
        return gave_up

    def _clear(self, head: Authentication | None, counter: int | None) -> None:
        self.head, self.head_counter, self.given = head, counter, False
        self.pages, self.early, self.counters = {}, {}, {}

    def data(self) -> AuthenticationData | None:
        """Return the complete data, once; None while a page is missing that cannot be restored."""
        head = self.head
        if self.given or head is None or head.last_page is None or head.length is None:
            return None
        count = _pages_for(head.length)
        if len(self.pages) + len(self.early) < count - 2:
            return None  # more than one page is missing
        parts = [self._part(number) for number in range(1, count)]
        if None in parts and not self._restore(head, parts):
            return None
        self.given = True
        first = head.data[:PAGE_0_DATA].ljust(PAGE_0_DATA, b"\0")
        whole = b"".join((first, *(part for part in parts if part is not None)))[: head.length]
        return AuthenticationData(head.auth_type, head.timestamp_utc_s, whole, self._consistent())

    def _part(self, number: int) -> bytes | None:
        return self.pages.get(number) or self.early.get(number)

    def _restore(self, head: Authentication, parts: list[bytes | None]) -> bool:
        """Restore the one missing page from the parity page, in place; False if that is not possible."""
        last, length = head.last_page or 0, head.length or 0
        others = [self._part(number) for number in range(len(parts) + 1, last + 1)]
        if last != _pages_for(length + 1) or parts.count(None) != 1 or None in others:
            return False
        held = [part for part in (*parts, *others) if part is not None]
        parts[parts.index(None)] = _xor([_page_0_bytes(head), *held])
        return True

    def _consistent(self) -> bool:
        """Whether the counters are those of one set: equal on all pages, or rising by one with each page."""
        first = self.head_counter
        if first is None or None in self.counters.values():
            return False
        steps = {number: ((counter or 0) - first) & 0xFF for number, counter in self.counters.items()}
        return all(step == 0 for step in steps.values()) or all(n == step for n, step in steps.items())


class Assembler:
    """Assembles the pages of many sources, and drops sets that receive no more pages.

    Sets of sources that the caller vouches for are held apart, so that a flood from others does not end them.

    Args:
        max_sets: Number of page sets held at once of either kind, one for each source and type. The one
            untouched for longest is dropped first. A set holds at most 2 x 15 pages.
        timeout_s: After this long without a page, the next page starts the set anew.
    """

    def __init__(self, max_sets: int = 256, timeout_s: float = 15.0) -> None:
        self.max_sets = max_sets
        self.timeout_s = timeout_s
        self.gave_up = False
        """Whether the last page began a new set while pages of the one before were missing."""
        self._sets: tuple[OrderedDict[tuple[str, int], _PageSet], ...] = (OrderedDict(), OrderedDict())

    def __len__(self) -> int:
        """Number of page sets held."""
        return sum(map(len, self._sets))

    def held_bytes(self) -> int:
        """Number of bytes of page data held."""
        held = [s for sets in self._sets for s in sets.values()]
        return sum(len(part) for s in held for part in (*s.pages.values(), *s.early.values())) + sum(
            len(s.head.data) for s in held if s.head is not None
        )

    def add_page(
        self,
        source: str,
        page: Authentication,
        now_s: float,
        counter: int | None = None,
        *,
        vouched: bool = False,
    ) -> AuthenticationData | None:
        """Take in one page. Return the data if this page completed it, else None.

        Args:
            counter: Message counter of the frame; None if unknown.
            vouched: Whether the set is held apart from those of strangers.
        """
        key = (source, page.auth_type)
        sets = self._sets[vouched]
        pages = sets.pop(key, None) or self._sets[not vouched].pop(key, None)
        self.gave_up = False
        if pages is None or now_s - pages.touched_s > self.timeout_s:
            self.gave_up = pages is not None and pages.head is not None and not pages.given
            pages = _PageSet(now_s)
        sets[key] = pages
        if len(sets) > self.max_sets:
            sets.popitem(last=False)
        pages.touched_s = now_s
        self.gave_up = pages.add_page(page, counter) or self.gave_up
        return pages.data()
