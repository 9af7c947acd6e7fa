"""A greenhouse: relays by the hour, limits that always hold, months without a hand."""

import esair
from esair.drivers.bme280 import Climate
from esair.drivers.clock import WallTime

PLAN = {
    "heater": ((6.0, 9.0), (17.0, 22.0)),  # hours of the day, from and to
    "pump": ((7.0, 8.0), (19.0, 20.0)),
    "lamp": ((16.0, 21.0),),
}


class NotTooWarm(esair.Reaction):
    """The heater heats only below 26 °C, and not while the air is unknown."""

    air = esair.reads(Climate, max_age=3.0)
    heater = esair.guards(bool)

    def react(self, air: Climate, heater: bool) -> bool:
        return heater and air.temperature < 26.0


class NotTooWet(esair.Reaction):
    """The pump runs only while the soil is dry, and not while that is unknown."""

    soil = esair.reads(float, max_age=3.0)  # V of a probe: 2.1 in water, 2.8 in air
    pump = esair.guards(bool)

    def react(self, soil: float, pump: bool) -> bool:
        return pump and soil > 2.4


class Plan(esair.Behavior):
    """Switches every relay as the plan says."""

    restart = esair.Restart(retry=300.0)
    clock = esair.reads(WallTime)
    heater = esair.writes(bool)
    pump = esair.writes(bool)
    lamp = esair.writes(bool)

    async def run(self) -> None:
        relays = {"heater": self.heater, "pump": self.pump, "lamp": self.lamp}
        async for clock in self.clock:
            for name, relay in relays.items():
                on = any(begin <= clock.hours < end for begin, end in PLAN[name])
                await relay.write(on)
