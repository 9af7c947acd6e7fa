"""The tank, with units that are none."""

import asyncio

import pytest

from esair.testing import FakeSerial

pytest.importorskip("pymodbus", reason="the extra 'modbus' is not installed")

import modbus_pump

from esair.drivers.modbus.fake import FakeModbus

pytestmark = pytest.mark.virtual_clock


async def test_it_fills_the_tank_and_stops() -> None:
    """The more is missing the faster; and not blindly."""
    line = FakeSerial("line", framing="modbus-rtu")
    level = FakeModbus(line, inputs={0: 900}, unit=3)
    pump = FakeModbus(line, {8192: 0}, unit=4)
    line.on_frame = lambda message: level.hear(message) or pump.hear(message)

    async with modbus_pump.make_robot(line):
        await asyncio.sleep(1.0)
        assert pump.holding[8192] == 600
        level.inputs[0] = 1190
        await asyncio.sleep(1.0)
        assert pump.holding[8192] == 20
        level.silent = True
        await asyncio.sleep(5.0)
        assert pump.holding[8192] == 0
    assert pump.holding[8192] == 0
