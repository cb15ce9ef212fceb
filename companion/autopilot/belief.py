"""Decides which frames are accepted on a signed link, and explains what was rejected."""

from __future__ import annotations

from companion.autopilot.heard_vehicle import LOST_AFTER_S, HeardVehicle
from companion.autopilot.signing import Refusal, Signing
from companion.autopilot.wire import Frame

_ALL_REFUSED = {
    Refusal.UNSIGNED: "unsigned: signing is not set up on the autopilot",
    Refusal.WRONG: "wrongly signed: the autopilot has a different key",
    Refusal.REPLAYED: "a replay: old frames are being sent again, or the autopilot's timestamp went back",
    Refusal.STALE: "more than a minute old: the autopilot does not receive our frames, or it is a replay",
    Refusal.CROWDED: "rejected: too many signing senders on this link",
}
"""Explanations for the case that every frame of the vehicle is rejected."""


class Belief:
    """Checks the signature of each frame and tracks whether the vehicle's own frames are accepted."""

    def __init__(self, signing: Signing, heard: HeardVehicle) -> None:
        self._signing = signing
        self._heard = heard
        self._believed_s: float | None = None
        self._refused: tuple[Refusal, float] | None = None
        """Why the latest rejected frame of the vehicle was rejected, and when."""

    def believes(self, frame: Frame, now_s: float) -> bool:
        """Whether a frame is accepted."""
        refused = self._signing.refusal(frame)
        if self._heard.may_be_ours(frame):
            if refused is None:
                self._believed_s = now_s
            else:
                self._refused = refused, now_s
        return refused is None

    def disbelief(self, now_s: float) -> str | None:
        """What is being rejected, in words; None when nothing is."""
        heard_s = self._believed_s
        if self._refused is not None and (heard_s is None or now_s - heard_s > LOST_AFTER_S):
            reason, refused_s = self._refused
            if now_s - refused_s <= LOST_AFTER_S:
                return f"every frame of the vehicle is {_ALL_REFUSED[reason]}"
        return self._signing.counts.refused()
