"""What type checkers say of robot scripts. Each expected error is marked; no other is."""

from typing import assert_type

import attrs

import esair
from esair.actions import ActuatorPort
from esair.buses import CanBus, I2CBus
from esair.drivers.ads1115 import Ads1115
from esair.drivers.gpio import DigitalOutput
from esair.drivers.odrive import OdriveAxis


@attrs.frozen
class Twist:
    linear: float


@attrs.frozen
class Docked:
    bay: int


@attrs.frozen
class Dock(esair.Request[Docked]):
    bay: int


class Captain(esair.Behavior):
    wheels = esair.writes(Twist)

    async def run(self) -> None:
        assert_type(await self.ask("docking", Dock(2), timeout=None), Docked)
        await self.ask("docking", 2)  # type: ignore[arg-type]
        sender, _ = await self.receive_from(timeout=1.0)
        assert_type(sender, str)
        assert_type(await self.receive(as_type=Docked), Docked)
        assert_type(await self.receive_from(as_type=Docked), tuple[str, Docked])
        assert_type(await self.get("docking", as_type=Docked), Docked)
        lamp = await self.register("lamp", esair.Access.WRITE, as_type=bool)
        assert_type(lamp, ActuatorPort[bool])
        await lamp.write("on")  # type: ignore[arg-type]
        sonar = await self.register("sonar", esair.Access.READ)
        sonar.write(1.0)  # type: ignore[attr-defined]
        answer = await self.wheels.write(Twist(0.1))
        if not answer:
            assert_type(answer.holder, str)
        else:
            assert_type(answer.command, Twist)


class Docking(esair.Behavior):
    orders = esair.takes(Dock, queue=4)

    async def run(self) -> None:
        async for request in self.orders:
            assert_type(request, Dock)
            assert_type(request.data, Dock)
            async with request:
                request.answer(Docked(request.bay))
                request.answer(request.bay)  # type: ignore[arg-type]

    @esair.answers
    async def dock(self, request: Dock) -> Docked:
        return Docked(request.bay)

    @esair.answers  # type: ignore[type-var]
    async def number(self, request: int) -> int:
        return request


class InThread(esair.ThreadBehavior):
    sonar = esair.reads(float)
    wheels = esair.writes(Twist, configure=True)
    orders = esair.takes(Dock)

    def run(self) -> None:
        assert_type(self.sonar.read(fresh=True), float)
        self.sonar.read(fres=True)  # type: ignore[call-arg]
        for distance in self.sonar:
            assert_type(distance, float)
        answer = self.wheels.write(Twist(0.1), hold=0.5)
        if not answer:
            assert_type(answer.holder, str)
        self.wheels.write(0.1)  # type: ignore[arg-type]
        self.wheels.configure(speed=1.0)
        self.wheels.release()
        lamp = self.register("lamp", esair.Access.WRITE, as_type=bool)
        lamp.write("on")  # type: ignore[arg-type]
        assert_type(self.get("docking", as_type=Docked), Docked)
        self.put("captain", 1)
        assert_type(self.ask("docking", Dock(1)), Docked)
        assert_type(self.perform(Turn(), timeout=1.0), bool)
        for request in self.orders:
            assert_type(request, Dock)
            with request:
                request.answer(Docked(1))


class Turn(esair.Reaction):
    wheels = esair.writes(Twist)


def parts(i2c: I2CBus, can: CanBus) -> object:
    return [
        Ads1115(name="light", bus=i2c, address=0x49, full_scale=2.048, rate=5.0),
        Ads1115(bus=i2c, adress=0x49),  # type: ignore[call-arg]
        OdriveAxis(bus=can, node=3, heartbeat_timeout=0.2, required=True),
        OdriveAxis(bus=can, node=3, rate=5.0),  # type: ignore[call-arg]
        DigitalOutput(chip="gpiochip0", line=17, active_low=True),
        DigitalOutput(chip="gpiochip0", line=17, aktive_low=True),  # type: ignore[call-arg]
    ]
