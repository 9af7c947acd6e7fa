"""A tractor that mows by itself, is driven by hand, and has a fence."""

import attrs

import esair


@attrs.frozen
class Drive:
    """How it moves."""

    speed: float  # m/s, forward
    turn: float  # rad/s, to the left


class Tracks(esair.Actuator[Drive]):
    """Its two tracks; a real driver would write to a motor controller here."""

    safe = Drive(0.0, 0.0)
    limits = {"speed": (-0.5, 1.0), "turn": (-1.0, 1.0)}  # noqa: RUF012 - read only
    command_timeout = 0.5

    async def write(self, command: Drive) -> None:
        """Nothing is connected."""


class Gate(esair.Sensor[bool]):
    """Whether the gate of the field is open."""

    rate = 10.0
    is_open = False

    async def read(self) -> bool:
        return self.is_open


class Fence(esair.Reaction):
    """While the gate is open nobody drives forward, people neither."""

    gate = esair.reads(bool)
    tracks = esair.guards(Drive)

    def react(self, gate: bool, tracks: Drive) -> Drive | None:
        return attrs.evolve(tracks, speed=min(tracks.speed, 0.0)) if gate else tracks


class Mow(esair.Behavior):
    """Mows slowly, up and down."""

    tracks = esair.writes(Drive)

    async def run(self) -> None:
        async for _ in esair.every(0.1):
            await self.tracks.write(Drive(0.2, 0.0))
