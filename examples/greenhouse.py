"""A greenhouse: relays, a plan of the day, limits that always hold, and a hand.

`Plan` switches the relays by the hour. Guards keep the limits, whoever switches: no heat
when it is warm, no water on wet soil, and neither while the sensor for it is silent.
`Hand` holds one relay for a while when a person asks: above the plan, below the guards.
"""

import attrs

import esair

PLAN = {
    "heater": ((6.0, 9.0), (17.0, 22.0)),  # hours of the day, from and to
    "pump": ((7.0, 8.0), (19.0, 20.0)),
    "lamp": ((16.0, 21.0),),
}


@attrs.frozen
class Switch(esair.Request[float]):
    """Hold a relay; the answer is for how long it was held, in seconds."""

    relay: str
    on: bool
    seconds: float


class NotTooWarm(esair.Reaction):
    """The heater heats only below 26 °C."""

    air = esair.reads(float, max_age=3.0)
    heater = esair.guards(bool)

    def react(self, air: float, heater: bool) -> bool:
        return heater and air < 26.0


class NotTooWet(esair.Reaction):
    """The pump runs only while the soil is drier than 40 %."""

    soil = esair.reads(float, max_age=3.0)
    pump = esair.guards(bool)

    def react(self, soil: float, pump: bool) -> bool:
        return pump and soil < 0.4


class Plan(esair.Behavior):
    """Switches every relay as the plan says."""

    hour = esair.reads(float)
    heater = esair.writes(bool)
    pump = esair.writes(bool)
    lamp = esair.writes(bool)

    async def run(self) -> None:
        relays = {"heater": self.heater, "pump": self.pump, "lamp": self.lamp}
        async for hour in self.hour:
            for name, relay in relays.items():
                await relay.write(any(begin <= hour < end for begin, end in PLAN[name]))


class Hand(esair.Behavior):
    """Holds a relay on or off while a person wants it so."""

    heater = esair.writes(bool, priority=10)
    pump = esair.writes(bool, priority=10)
    lamp = esair.writes(bool, priority=10)

    @esair.answers
    async def switch(self, request: Switch) -> float:
        """Hold it until the time is over or a guard says no."""
        relays = {"heater": self.heater, "pump": self.pump, "lamp": self.lamp}
        if request.relay not in relays:
            raise esair.RefusedError(f"there are {', '.join(relays)}")
        relay = relays[request.relay]
        async for seconds in esair.every(0.5):
            if seconds >= request.seconds:
                break
            answer = await relay.write(request.on)
            if not answer:
                raise esair.RefusedError(f"{answer.holder} has it: {answer.rule}")
            if answer.command != request.on:
                raise esair.RefusedError(f"{answer.by} does not allow it now")
        await relay.release()
        return request.seconds


class House:
    """Pretends to be the greenhouse; ten minutes pass in a second."""

    hour, air, soil = 5.5, 14.0, 0.3  # h, °C, share of water

    def __init__(self) -> None:
        self.on: dict[str, bool] = {}

    def pass_a_minute(self) -> float:
        """Warm up, cool down, dry out."""
        self.hour = (self.hour + 1 / 60) % 24
        self.air += 0.1 * self.on.get("heater", False) - 0.004 * (self.air - 8.0)
        self.soil += 0.005 * self.on.get("pump", False) - 0.0002
        return self.hour


class Part(esair.Sensor[float]):
    """A number of the house; the clock among them lets the time pass."""

    rate = 10.0

    def __init__(self, house: House, name: str) -> None:
        super().__init__(name=name)
        self.house = house

    async def read(self) -> float:
        if self.name == "hour":
            self.house.pass_a_minute()
        return float(getattr(self.house, self.name))


class Relay(esair.Actuator[bool]):
    """Switches one thing; off when nobody has wanted it on for two seconds."""

    safe = False
    command_timeout = 2.0

    def __init__(self, house: House, name: str) -> None:
        super().__init__(name=name)
        self.house = house

    async def write(self, command: bool) -> None:
        if command != self.house.on.get(self.name):
            print(f"{self.house.hour:.2f} h: {self.name} {command}", flush=True)
        self.house.on[self.name] = command


def make_robot(house: House) -> esair.Robot:
    """Return the greenhouse and who cares for it."""
    parts = [Part(house, name) for name in ("hour", "air", "soil")]
    return esair.Robot(
        name="greenhouse",
        resources=[*parts, *(Relay(house, name) for name in PLAN)],
        behaviors=[NotTooWarm(), NotTooWet(), Plan(), Hand()],
    )


robot = make_robot(House())

if __name__ == "__main__":
    esair.run(robot)
