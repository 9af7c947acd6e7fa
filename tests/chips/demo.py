"""The reflexes of the demo on an ATmega328P: what they take, and how long."""

import shutil
from pathlib import Path

from tests.chips import avr

from esair.firmware.c import build

ROVER = Path(__file__).parents[2] / "examples" / "minimal_rover" / "robot.toml"


def rover(folder: Path, *, guarded: bool = True) -> Path:
    """Return the reflexes of the demo: the example has two of the three."""
    name = f"rover_{folder.name}"  # a process has one module of a name
    shutil.copy(ROVER.parent / "rover_pins.py", folder / f"{name}.py")
    path = folder / "robot.toml"
    text = ROVER.read_text().replace("rover_pins:", f"{name}:")
    brake = '\n[behavior.brake]\ndriver = "esair.demo:Brake"\n'
    path.write_text(text + brake * guarded)
    return path


FIXED = """
static volatile real near = 1.0f;
static volatile bool touched;
static real told;
bool read_ranges(Robot_Scan *v)
{
    *v = (Robot_Scan){-0.6f, 0.6f, {{near, near, near}}};
    return true;
}
bool read_bumper(Robot_Touch *v)
{
    v->left = touched;
    v->right = false;
    return true;
}
bool write_wheels(Robot_Twist v)
{
    told = v.linear;
    return true;
}
"""

TIMED = """
extern uint8_t __heap_start;
int main(void)
{
    uint16_t worst = 0;
    uint8_t *top = (uint8_t *)SP, *low = &__heap_start;
    begin();
    for (uint8_t *p = low; p < top - 8; p++) *p = 0xA5;
    robot_open();
    for (int i = 0; i < 200; i++) {
        near = i % 40 < 20 ? 1.0f : 0.18f;
        touched = i % 60 == 30;
        uint16_t from = TCNT1;
        robot_step();
        uint16_t took = TCNT1 - from;
        if (took > worst) worst = took;
    }
    while (*low == 0xA5) low++;
    printf("= %u %u\\n", worst, (unsigned)(RAMEND - (uint16_t)low));
    end();
}
"""


def measured(folder: Path, *, guarded: bool) -> tuple[int, int, int]:
    """Return the bytes of flash, of RAM with the stack, and the cycles of the worst step."""
    build(rover(folder, guarded=guarded), folder, target="avr", arm="always")
    endless = FIXED + "int main(void) { robot_open(); for (;;) robot_step(); }"
    program, ram = avr.sizes(avr.compiled(folder / "robot", endless))
    lines = avr.printed(avr.compiled(folder / "robot", FIXED + TIMED))
    worst, stack = map(int, lines[-1].split()[1:])
    return program, ram + stack, worst
