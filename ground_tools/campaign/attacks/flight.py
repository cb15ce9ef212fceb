"""Flies one encounter under attack in lock-step: in one thread and in virtual time.

In every step of 0.05 s, the aircraft send the frames that are due, the attacker sends as many frames as its
budget allows, and each companion receives the frames that have arrived and steps once, as in its flight loop.
The core gets telemetry as events. Remote ID is encoded to frames and decoded again. Gate and MAVLink are left
out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from companion.events import Event, FlightMode
from companion.geometry import Vec3
from companion.radio.frames_io import FrameSender, radio_address
from companion.remote_id.transports import WIFI_BEACON
from ground_tools.campaign.attacks import scene as scenes
from ground_tools.campaign.attacks.air import POWER_DBM, SENDERS_SIGMA_DB, Air
from ground_tools.campaign.attacks.attacker import (
    Aircraft,
    Attacker,
    Budget,
    Clock,
    Silent,
    View,
    place_of,
    plus,
)
from ground_tools.campaign.attacks.craft import PEER, STEP_S, Guided, avoiding_aircraft, own_aircraft
from ground_tools.campaign.attacks.kinds import KINDS, Attack, draw_attack
from ground_tools.campaign.attacks.messages import report
from ground_tools.campaign.attacks.outcome import Judge, Row
from ground_tools.campaign.attacks.scene import Cell, Honest, Scene

_ATTACKER: Final = "attacker"


class Plain:
    """An honest aircraft without a companion. It sends with the errors of its own GNSS receiver."""

    def __init__(self, honest: Honest, number: int, scene: Scene, rng: np.random.Generator) -> None:
        self.name = f"{PEER}{number}"
        self._honest, self._scene = honest, scene
        self._bias = 1.5 * rng.standard_normal(3)
        self._clock = Clock(honest.sends_from_s + float(rng.uniform(0.0, 1.0 / honest.rate)))
        self._sender = FrameSender(radio_address(self.name))

    @property
    def address(self) -> str:
        """Radio address of its Remote ID."""
        return self._sender.address

    def at(self, now_s: float) -> Aircraft:
        """Its true state at a time."""
        return Aircraft(*self._honest.state(now_s - self._scene.meeting_s))

    def frames(self, now_s: float, lie: Vec3) -> list[bytes]:
        """The frames that it sends in this step.

        Args:
            lie: offset (NED, m) of the position that it sends.
        """
        if not self._clock.due(now_s, self._honest.rate):
            return []
        true = self.at(now_s)
        n, e, d = self._bias.tolist()
        place = plus(plus(true.position, (n, e, d)), lie)
        return self._sender.frames(WIFI_BEACON, report(self.name, now_s, place, true.velocity))


class World:
    """Everything that flies in one scene."""

    def __init__(self, scene: Scene, attacker: Attacker, place: Vec3, power_dbm: float) -> None:
        self.scene, self.attacker = scene, attacker
        self._place, self._power_dbm = place, power_dbm
        streams = np.random.SeedSequence([scene.seed, 17]).spawn(len(scene.honest) + 1)
        rngs = [np.random.default_rng(s) for s in streams]
        self.own = own_aircraft(scene, rngs[-1])
        self.honest: list[Guided | Plain] = [
            avoiding_aircraft(scene, number, rng)
            if honest.manner == "avoiding"
            else Plain(honest, number, scene, rng)
            for number, (honest, rng) in enumerate(zip(scene.honest, rngs, strict=False))
        ]
        self.guided = [self.own, *(h for h in self.honest if isinstance(h, Guided))]
        self.air = Air(scene.seed, signal=scene.signal)
        for craft in self.guided:
            self.air.join(craft.name)
        self._power = {
            craft.name: POWER_DBM + SENDERS_SIGMA_DB * float(rng.standard_normal())
            for craft, rng in zip([*self.honest, self.own], rngs, strict=True)
        }
        self._senders = {craft.name: FrameSender(craft.address) for craft in self.guided}
        self._forged: dict[str, FrameSender] = {}
        self._budget = Budget()

    def state(self, craft: Guided | Plain, now_s: float) -> Aircraft:
        """True state of an aircraft."""
        if isinstance(craft, Guided):
            return Aircraft(craft.body.position, craft.body.velocity)
        return craft.at(now_s)

    def view(self, now_s: float) -> View:
        """What the attacker knows."""
        return View(
            self.state(self.own, now_s),
            tuple(self.state(h, now_s) for h in self.honest),
            tuple(h.name for h in self.honest),
            tuple(h.address for h in self.honest),
        )

    def step(self, now_s: float) -> None:
        """Send, hear, decide and move."""
        receivers = {craft.name: craft.body.position for craft in self.guided}
        for number, craft in enumerate(self.honest):
            if isinstance(craft, Plain):
                lie = self.attacker.lie() if number == 0 else (0.0, 0.0, 0.0)
                for frame in craft.frames(now_s, lie):
                    self._honestly(now_s, craft, craft.at(now_s).position, frame, receivers)
        view = self.view(now_s)
        self._attack(now_s, view, receivers)
        seen = self.attacker.reports(now_s, view)
        for craft in self.guided:
            heard: Sequence[Event] = self.air.heard(craft.name, now_s)
            place = craft.body.position
            for broadcast in craft.step(now_s, [*heard, *seen]):
                for frame in self._senders[craft.name].frames(broadcast.transport, broadcast.messages):
                    self._honestly(now_s, craft, place, frame, receivers)

    def _honestly(
        self, now_s: float, craft: Guided | Plain, place: Vec3, frame: bytes, receivers: dict[str, Vec3]
    ) -> None:
        power = self._power[craft.name]
        self.attacker.overhear(now_s, craft.name, WIFI_BEACON, craft.address, frame)
        self.air.send(
            now_s, craft.name, place, receivers, WIFI_BEACON, craft.address, frame, power, honest=True
        )

    def _attack(self, now_s: float, view: View, receivers: dict[str, Vec3]) -> None:
        self._budget.pass_time(STEP_S)
        for sent in self.attacker.send(now_s, view):
            if not self._budget.spend(sent.transport):
                continue
            frames = [sent.frame]
            if not sent.frame:
                sender = self._forged.setdefault(sent.address, FrameSender(sent.address))
                frames = sender.frames(sent.transport, sent.messages)
            for frame in frames:
                power = self._power_dbm - sent.quieter_db
                self.air.send(
                    now_s, _ATTACKER, self._place, receivers, sent.transport, sent.address, frame, power,
                    honest=False,
                )  # fmt: skip


def fly(cell: Cell, seed: int, attack: Attack | None = None) -> Row:
    """Fly the encounter of a seed.

    Args:
        attack: the attack to fly; None: the one that the seed draws.

    Raises:
        ConfigError: the attack is not allowed.
    """
    scene = scenes.draw(cell, seed)
    attack = attack or draw_attack(cell.kind, seed)
    attack.check()
    if attack.kind != cell.kind:
        raise ValueError(f"the attack is of kind {attack.kind}, the cell of kind {cell.kind}")
    make = KINDS[attack.kind].make if cell.attacked else Silent
    attacker = make(attack.values, scene, np.random.default_rng([seed, 19]))
    world = World(scene, attacker, place_of(attack.values), attack.values.get("power_dbm", 20.0))
    return judged(world, _met(cell, scene))


def judged(world: World, met: str) -> Row:
    """Fly a world to its end. Returns its outcome."""
    scene, judge = world.scene, Judge(world.scene, met)
    avoids = [True, *(isinstance(h, Guided) for h in world.honest)]
    for tick in range(math.ceil(scene.end_s / STEP_S)):
        now_s = tick * STEP_S
        world.step(now_s)
        after_s = now_s + STEP_S
        places = [world.state(c, after_s).position for c in (world.own, *world.honest)]
        on_mission = world.own.mode is FlightMode.MISSION if world.own.guards else None
        judge.look(after_s, STEP_S, places, avoids, on_mission=on_mission)
    return judge.row()


def _met(cell: Cell, scene: Scene) -> str:
    if cell.kind in scenes.LEADING:
        return scenes.herd_of(scene.seed)
    return scene.honest[0].manner
