"""A stand-in for ``rp2``: assembles a program of PIO and runs it, cycle by cycle.

The pins are those of `esair.boards.stand_in`: every edge of its `turn` lasts `PACE` cycles.
It runs on MicroPython too, as ``rp2.py``. What it does not model fails.
"""

WORD = 0xFFFFFFFF
PACE = 25

machines: dict[int, "StateMachine"] = {}  # the state machines, by number


class PIO:
    SHIFT_LEFT = 0
    SHIFT_RIGHT = 1


class Program:
    def __init__(self):
        self.code = []
        self.labels = {}
        self.bottom = 0
        self.top = 31

    def words(self):
        """What a program may say: instructions, directives, registers, conditions."""
        found = {each: self._instruction(each) for each in INSTRUCTIONS}
        registers = ("pins", "pin", "x", "y", "isr", "osr", "noblock")
        found.update({each: each for each in registers})
        found.update({each: each for each in CONDITIONS})
        found["invert"] = lambda source: "~" + source
        found["label"] = lambda name: self.labels.update({name: len(self.code)})
        found["wrap_target"] = lambda: setattr(self, "bottom", len(self.code))
        found["wrap"] = lambda: setattr(self, "top", len(self.code) - 1)
        return found

    def _instruction(self, name):
        return lambda *operands: self.code.append((name, operands))


def asm_pio(out_shiftdir=PIO.SHIFT_LEFT):
    """Assemble as rp2 does: the function runs with other globals, on import."""

    def assembled(function):
        program = Program()
        program.out_right = out_shiftdir == PIO.SHIFT_RIGHT
        names = function.__globals__
        kept = dict(names)
        names.clear()
        names.update(program.words())
        function()
        names.clear()
        names.update(kept)
        assert len(program.code) <= 32
        return program

    return assembled


class StateMachine:
    def __init__(self, number, program, jmp_pin, in_base):
        if not 0 <= number < 8:
            raise ValueError("invalid StateMachine")
        machines[number] = self
        self.program = program
        self.jmp_pin, self.in_base = jmp_pin, in_base
        self.x = self.y = self.osr = 0x5A5A5A5A  # a restart leaves what was in them
        self.isr = 0
        self.at = 0
        self.queue = []
        self.on = 0

    def active(self, on):
        self.on = on
        for each in (self.jmp_pin, self.in_base):
            each.irq(lambda pin: self.run(PACE))

    def rx_fifo(self):
        return len(self.queue)

    def get(self):
        while not self.queue:
            self.step()
        return self.queue.pop(0)

    def run(self, cycles):
        for _ in range(cycles if self.on else 0):
            self.step()

    def step(self):
        name, operands = self.program.code[self.at]
        wraps = self.at == self.program.top
        self.at = self.program.bottom if wraps else self.at + 1
        INSTRUCTIONS[name](self, *operands)  # type: ignore[operator]

    def source(self, name):
        if name[0] == "~":
            return self.source(name[1:]) ^ WORD
        if name == "pins":  # the other pins of the board are high
            return WORD - 1 + self.in_base.value()
        return {"x": self.x, "y": self.y, "isr": self.isr, "osr": self.osr}[name]

    def into(self, name, value):
        assert name in ("x", "y", "isr", "osr")
        setattr(self, name, value)

    def in_(self, source, bits):
        low = self.source(source) & ((1 << bits) - 1)
        self.isr = (self.isr << bits | low) & WORD

    def out(self, target, bits):
        if self.program.out_right:
            value, self.osr = self.osr & ((1 << bits) - 1), self.osr >> bits
        else:
            value, self.osr = self.osr >> (32 - bits), self.osr << bits & WORD
        self.into(target, value)

    def push(self, how):
        assert how == "noblock"
        if len(self.queue) < 4:
            self.queue.append(self.isr)
        self.isr = 0

    def jmp(self, *condition_and_label):
        if len(condition_and_label) == 1 or CONDITIONS[condition_and_label[0]](self):
            self.at = self.program.labels[condition_and_label[-1]]

    def mov(self, target, source):
        self.into(target, self.source(source))

    def set(self, target, value):
        assert 0 <= value < 32
        self.into(target, value)

    def x_dec(self):
        self.x, before = (self.x - 1) & WORD, self.x
        return before != 0


INSTRUCTIONS = {
    "in_": StateMachine.in_,
    "out": StateMachine.out,
    "push": StateMachine.push,
    "jmp": StateMachine.jmp,
    "mov": StateMachine.mov,
    "set": StateMachine.set,
}

CONDITIONS = {
    "pin": lambda machine: machine.jmp_pin.value(),
    "not_y": lambda machine: machine.y == 0,
    "x_dec": StateMachine.x_dec,
}
