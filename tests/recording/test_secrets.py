"""What nobody may read is not in a recording."""

from __future__ import annotations

import asyncio
import hashlib
import tomllib
from pathlib import Path

import pytest

import esair
from esair.config import build, load
from esair.recording import facts_of
from esair.standard import public_text

pytest.importorskip("foxglove", reason="needs esair[record]")

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("REC-4")]

MODULE = """
import esair

class Radio(esair.Sensor[float]):
    key = esair.setting("none", secret=True)
    channel = esair.setting(1)

    async def read(self) -> float:
        return 1.0
"""

FILE = '''
[robot]
name = "spy"
# the old key was open-sesame-1
[sensor.radio]
driver = "spying:Radio"
key = """open-sesame-2"""
channel = 7
[sensor.radio.sim]
key = "open-sesame-3"
[sensor]
inline = { driver = "spying:Radio", key = "open-sesame-4", channel = 3 }
'''


async def test_secrets_of_the_file_are_not_kept(tmp_path: Path) -> None:
    """Neither in settings, wherever they stand, nor in comments; the hash is the file's."""
    (tmp_path / "spying.py").write_text(MODULE)
    file = tmp_path / "robot.toml"
    file.write_text(FILE)
    record = esair.Recording(tmp_path / "run.mcap", min_free=0)
    robot = build(load(file), lambda **given: esair.Robot(**given, record=record))
    async with robot:
        await asyncio.sleep(0.5)

    data = (tmp_path / "run.mcap").read_bytes()
    assert b"open-sesame" not in data
    facts = facts_of(tmp_path / "run.mcap")
    assert "open-sesame" not in str(facts)
    assert facts["replay"]["sha256"] == hashlib.sha256(file.read_bytes()).hexdigest()
    kept = tomllib.loads(facts["robot"]["robot.toml"])
    assert kept["sensor"]["radio"] == {
        "driver": "spying:Radio",
        "channel": 7,
        "sim": {},
    }
    assert kept["sensor"]["inline"] == {"driver": "spying:Radio", "channel": 3}


@pytest.mark.parametrize(
    "text",
    [
        '[page]\ntoken = "t"\nport = 1\n',
        'a = [1, 2.5, "x\\u007f\\n", true, inf, 1979-05-27T07:32:00Z, {b = "c.d"}]\n',
        '["quoted key"."dotted.key"]\n"é" = -inf\n[x]\n[x.y]\nz = 07:32:00\n',
    ],
)
def test_the_rest_says_the_same(text: str) -> None:
    """It is TOML again, with the same values."""
    wanted = tomllib.loads(text)
    wanted.get("page", {}).pop("token", None)
    assert tomllib.loads(public_text(text, [])) == wanted
