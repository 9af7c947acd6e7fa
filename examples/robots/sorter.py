"""Pick and place: eyes that are slow and crash, an arm of two servos, a light curtain."""

import attrs

import esair
from esair.drivers.servo import Goal


@attrs.frozen
class Seen:
    """Where the part lies, as the angles of the arm."""

    base: float  # rad
    lift: float  # rad


@attrs.frozen
class Look(esair.Request[Seen]):
    """Find the part."""


class Eyes(esair.ThreadBehavior):
    """Looks in a thread, one look at a time; a crash costs that look only."""

    looks = esair.takes(Look, queue=2)
    restart = esair.Restart(retry=60.0)

    def run(self) -> None:
        for request in self.looks:
            with request:
                request.answer(self.find())

    def find(self) -> Seen:
        """Return where the part lies; a real one would ask a camera."""
        return Seen(0.4, 0.8)


class Curtain(esair.Reaction):
    """One joint stays where it is while a hand is in the light curtain."""

    hand = esair.reads(bool, max_age=0.3)
    joint = esair.guards(Goal)

    def react(self, hand: bool, joint: Goal) -> Goal | None:
        return esair.REFUSE if hand else joint


class Place(esair.Behavior):
    """Look, pick, place; again and again."""

    base = esair.writes(Goal)
    lift = esair.writes(Goal)
    grip = esair.writes(bool)
    placed = 0

    async def run(self) -> None:
        while True:
            try:
                seen = await self.ask("eyes", Look(), timeout=5.0)
            except (esair.BehaviorFailedError, esair.BehaviorUnavailableError):
                await self.go(0.0, 1.5, 1.0, grip=False)  # wait, above the bench
                continue
            await self.go(seen.base, seen.lift + 0.3, 1.0, grip=False)
            await self.go(seen.base, seen.lift, 0.5, grip=True)
            await self.go(seen.base, 1.5, 0.5, grip=True)
            await self.go(-1.2, 1.0, 1.0, grip=True)
            await self.go(-1.2, 1.0, 0.3, grip=False)
            self.placed += 1

    async def go(self, base: float, lift: float, seconds: float, *, grip: bool) -> None:
        """Want the arm there for so long; what is refused takes longer."""
        let_through = 0.0
        async for _ in esair.every(0.05):
            told = [
                await self.base.write(Goal(base)),
                await self.lift.write(Goal(lift)),
                await self.grip.write(grip),
            ]
            let_through += 0.05 if all(told) else 0.0
            if let_through >= seconds:
                return
