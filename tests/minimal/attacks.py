"""What a lying host and a bad line do to a board: plain functions, for every interpreter.

Each observes what the motor is told.
"""

from binascii import crc32

from esair import minimal
from esair.boards import link
from esair.boards.line import Line
from esair.minimal import Actuator, Loop, Reaction, Sensor, reads, writes

STEP_MS = 20
SILENT = 20
"""Steps, more than the silence after which the host counts as gone."""


class Bumper(Sensor):
    hit = False

    def read(self):
        return self.hit


class Motor(Actuator):
    safe = 0.0
    limits = (-1.0, 1.0)

    def __init__(self):
        Actuator.__init__(self)
        self.told = []

    def write(self, command):
        self.told.append(command)


class Avoid(Reaction):
    bumper = reads(bool)
    motor = writes(float, priority=10)

    def react(self, bumper):
        return -0.5 if bumper else None


class Board:
    """A linked board whose line is two lists of bytes."""

    def __init__(self, armed=True, bumper=None, more=()):
        self.motor, self.bumper = Motor(), bumper or Bumper()
        orders = link.from_host((self.motor,))
        self.loop = Loop(
            [Avoid()] + orders,  # noqa: RUF005
            [self.bumper] + list(more) + [link.Host(link.HOST)],  # noqa: RUF005
            [self.motor],
            rate=1000 // STEP_MS,
            armed=armed,
        )
        self.come, self.said = bytearray(), []  # type: ignore[var-annotated]
        streams = self.came, self.read, lambda _ms: (1,), self.write
        self.line = Line(streams=streams)
        self.link = link.Link(self.loop, orders, "power-on", True, self.line)

    def came(self, _ms):
        return self.come[:1]

    def read(self, into):
        into[0] = self.come[0]
        self.come = self.come[1:]
        return 1

    def write(self, data, at, count):
        self.said.append(bytes(data[at : at + count]))

    def hear(self, *messages):
        for each in messages:
            self.come += stuffed(beat(self, of=each) if each in BEATS else each)

    def step(self, count=1, each=()):
        """Make steps; in each round these messages come, one for a step."""
        for _ in range(count):
            for message in each or (None,):
                if message is not None:
                    self.hear(message)
                self.loop.step()
                self.link()
                self.line.flush()

    @property
    def now(self):
        return self.motor.told[-1]


def stuffed(payload):
    """A message between zeros, by another way than that of the board."""
    data = payload + (crc32(payload) & 0xFFFFFFFF).to_bytes(4, "little")
    found = bytearray(b"\0")
    for piece in data.split(b"\0"):
        while len(piece) >= 254:
            found += b"\xff" + piece[:254]
            piece = piece[254:]
        found += bytes([len(piece) + 1]) + piece
    return bytes(found + b"\0")


def told(board):
    """What the board has said since the last time: messages without their checksums."""
    found = []
    for each in b"".join(board.said).split(b"\0"):
        at, data = 0, b""
        while at < len(each):
            code = each[at]
            data += each[at + 1 : at + code] + b"\0" * (code < 255)
            at += code
        if data:
            found.append(data[:-5])
    del board.said[:]
    return found


class Row(Sensor):
    """As many numbers as go over the line in half a kilobyte, and a bit."""

    rate: "float | None" = 1
    count = 560 // (8 if link.FLOAT == "d" else 4)

    def read(self):
        return [1.5] * self.count


def readings(rows, seconds):
    """How many times each of some rows has been told to a host, and told to be missing."""
    board = Board(more=rows)
    board.step(3, [ASK])
    told(board)
    names = [each.name for each in board.link.sensors]
    places = [names.index(each.name) for each in rows]
    board.step(1, [b"r" + b"".join([bytes((each, 100, 0)) for each in places])])
    found = [[0, 0] for _ in rows]
    for _ in range(seconds * 10 + 5):
        board.step(1, [BEAT])
        board.step(4)
        for each in told(board):
            if each[0] == 115:
                found[places.index(each[1])][each[2] == 120] += 1
    return board, found


BEAT, ASK, OTHER = "a beat", "one that asks for the names", "one of another version"
BEATS = {BEAT: (link.VERSION, 0), ASK: (link.VERSION, 1), OTHER: (link.VERSION + 1, 0)}


def beat(board, age=0, of=BEAT):
    """Answer what the board would have said in a beat, so many milliseconds ago."""
    return bytes((104,) + BEATS[of]) + moment(board, age)


def moment(board, age=0):
    """A time of the board, in the sixteenths of a beat."""
    return ((board.loop._ms - age >> 4) & 0xFFFF).to_bytes(2, "little")


def go(speed):
    buffer = bytearray(64)
    return b"w\0" + bytes(buffer[: link.packed(buffer, 0, speed)])


def driving():
    """A board that a host drives."""
    board = Board()
    board.step(5, [BEAT, go(0.5)])
    assert board.now == 0.5, board.motor.told
    return board


def attack_commands_without_beats_move_nothing():
    """The part of a host that decides is alive, the one that beats is not."""
    board = driving()
    board.step(SILENT, [go(0.25)])
    assert board.now == 0.0, board.motor.told


def attack_old_commands_are_no_beats():
    board = driving()
    board.step(SILENT)
    told = len(board.motor.told)
    board.step(SILENT, [go(0.5)])
    assert board.motor.told[told:] == [], board.motor.told


def attack_beats_that_come_back_bring_no_old_command():
    board = driving()
    board.step(SILENT)
    assert board.now == 0.0, board.motor.told
    board.step(SILENT, [BEAT])
    assert board.now == 0.0, board.motor.told
    board.step(2, [BEAT, go(0.25)])
    assert board.now == 0.25, board.motor.told


def attack_what_waited_while_the_board_was_held_up_moves_nothing():
    """Its part blocks a step for a second; meanwhile the computer goes on, or is killed."""
    for waited in range(0, 40, 3):
        board = driving()
        board.loop.skip(1000 // STEP_MS)
        for n in range(waited):
            board.hear(beat(board, 1000 + STEP_MS * (waited - n)), go(0.25))
        board.step(30)
        assert board.now == 0.0, board.motor.told
        assert 0.25 not in board.motor.told, board.motor.told
        board.step(3, [BEAT, go(0.75)])
        assert board.now == 0.75, board.motor.told


def attack_what_waits_delays_no_beat_of_now():
    """It is thrown away as fast as the line brings it, not a message in each step."""
    board = driving()
    board.loop.skip(1000 // STEP_MS)
    for _ in range(50):
        board.hear(beat(board, 1000), go(0.25))
    board.step(6, [BEAT, None, None, None, None])
    board.step(2, [BEAT, go(0.75)])
    assert board.now == 0.75, board.motor.told


def attack_the_step_that_was_held_up_takes_no_beat_for_new():
    """It hears the line before it knows how late it is."""
    board = driving()
    board.hear(beat(board), go(0.25))
    board.loop.step()
    board.link()
    board.loop.skip(400 // STEP_MS)
    board.step(30)
    assert 0.25 not in board.motor.told, board.motor.told


def attack_a_beat_counts_from_the_one_that_it_answers():
    board = driving()
    del board.motor.told[:]
    board.step(1, [beat(board, 200), go(0.25)])
    for order in board.link.orders:
        order.good_ms = 5000
    board.step(1, [beat(board, 240), go(0.5)])
    board.step(4)
    assert board.now == 0.5, board.motor.told
    board.step(1)
    assert board.now == 0.0, board.motor.told


def attack_a_long_command_does_not_outlive_a_silence():
    """It was good for five seconds, and nobody has given it again."""
    board = driving()
    board.link.orders[0].good_ms = 5000
    board.step(2, [BEAT, go(0.5)])
    board.step(SILENT)
    assert board.now == 0.0, board.motor.told
    board.step(SILENT, [BEAT])
    assert board.now == 0.0, board.motor.told


def attack_an_old_beat_disarms_and_never_arms():
    board = Board(armed=False)
    board.link.arms = True
    arm, disarm = (bytes([104, link.VERSION, each]) for each in (2, 4))
    board.step(30)
    old = moment(board, 400)
    board.step(2, [arm + old])
    assert not board.loop.armed
    board.step(2, [arm + moment(board)])
    assert board.loop.armed
    board.step(2, [disarm + old])
    assert not board.loop.armed


def attack_a_reflex_outranks_any_flood():
    board = driving()
    board.bumper.hit = True
    board.hear(*[go(1.0)] * 200)
    for _ in range(50):
        board.hear(BEAT, go(1.0), go(1.0))
        board.step(4)
    assert board.now == -0.5, board.motor.told
    assert 1.0 not in board.motor.told[5:], board.motor.told


def attack_each_flipped_bit_moves_nothing():
    whole = stuffed(go(1.0))
    board = driving()
    for at in range(len(whole)):
        for bit in (0, 3, 7):
            damaged = bytearray(whole)
            damaged[at] ^= 1 << bit
            board.come += damaged
            board.step(1, [BEAT, go(0.5)])
        assert 1.0 not in board.motor.told, at
    board.step(2, [BEAT, go(0.5)])
    assert board.now == 0.5, board.motor.told
    assert board.link.damaged > 0


def attack_each_truncated_message_moves_nothing():
    whole = stuffed(go(1.0))
    board = driving()
    for at in range(2, len(whole) - 1):  # at 1 it is whole
        board.come += whole[:at]
        board.step(2, [BEAT, go(0.5)])
        board.come += whole[at:-1] + b"\0"
        board.step(2, [BEAT, go(0.5)])
    assert 1.0 not in board.motor.told
    assert board.now == 0.5, board.motor.told


def attack_an_endless_message_takes_no_memory():
    board = driving()
    for _ in range(200):
        board.come += b"\1" * 100
        board.step(1)
    assert len(board.link.message) == link.LONGEST
    board.step(250)
    assert board.now == 0.0
    board.come += b"\0"
    board.step(10, [BEAT, go(0.5)])
    assert board.now == 0.5, board.motor.told


def attack_its_own_echo_is_no_host():
    board = driving()
    for _ in range(SILENT):
        for each in board.said:
            board.come += each
        del board.said[:]
        board.step(1)
    assert board.now == 0.0, board.motor.told


def attack_another_version_moves_nothing():
    board = driving()
    board.step(SILENT, [OTHER, go(1.0)])
    assert board.now == 0.0, board.motor.told
    assert 1.0 not in board.motor.told


def attack_two_hosts_of_two_versions_do_not_beat_for_each_other():
    board = driving()
    board.step(SILENT, [OTHER, go(1.0), b"B1", go(1.0), b"h", go(1.0)])
    assert board.now == 0.0, board.motor.told
    assert 1.0 not in board.motor.told


NAN = float("nan")
WRONG: "tuple[object, ...]" = (NAN, float("inf"), "x", True, (1.0, 1.0), {}, ())
LIES = [go(each)[2:] for each in WRONG]
LIES += [go({"actuator": "x"})[2:], go(((1.0,),))[2:], go(1.5)[2:], b"", b"d", b"f\0"]
LIES += [b"r\xff\xff", b"R\xff\xffd", b"j\3\0}}}", b"s\xff\xff", b"s\2\0\xff\xff"]
LIES += [b"?", b"r\1\0" * 80]


def attack_lies_are_no_commands():
    board = driving()
    for lie in LIES:
        board.step(3, [BEAT, b"w\0" + lie])
        board.step(3, [BEAT, go(0.5)])
        assert board.now == 0.5, (lie, board.motor.told[-8:])
    assert set(board.motor.told) == {0.0, 0.5}, set(board.motor.told)
    for message in (b"", b"w", b"w\x09f1234", b"Wmotor\0001", b"Z1", b"h", b"r\x09"):
        board.step(1, [message, BEAT, go(0.5)])
    assert board.now == 0.5, board.motor.told


def attack_a_line_that_takes_nothing_stops_no_reflex():
    """What cannot be said is a fault, and the board goes on."""
    board = driving()

    def write(data, at, count):
        raise OSError(5)

    board.line.write = write
    board.step(10, [BEAT, go(0.5)])
    board.bumper.hit = True
    board.step(2)
    assert board.now == -0.5, board.motor.told
    assert board.line.lost > 0


def attack_a_line_that_cannot_be_read_is_a_silent_host():
    board = driving()

    def read(into):
        raise OSError(5)

    board.line.read = read
    board.come += b"x"
    board.step(SILENT)
    assert board.now == 0.0, board.motor.told
    board.bumper.hit = True
    board.step(2)
    assert board.now == -0.5, board.motor.told


def attack_a_host_that_goes_leaves_reflexes():
    board = driving()
    board.step(SILENT)
    assert board.now == 0.0
    board.bumper.hit = True
    board.step(2)
    assert board.now == -0.5, board.motor.told


def attack_the_counter_wraps():
    """The milliseconds of a board begin anew after twelve days, amid two steps."""
    clock = [0x3FFFFFFF - 5 * STEP_MS - 7]
    real = minimal._ticks, minimal._sleep

    def sleep(ms):
        clock[0] = (clock[0] + ms) & 0x3FFFFFFF

    minimal._ticks, minimal._sleep = (lambda: clock[0]), sleep
    board = Board()

    def feed():
        board.link()
        board.hear(go(0.5) if board.loop.steps % 2 else BEAT)

    try:
        board.loop.run(20, feed)
    finally:
        minimal._ticks, minimal._sleep = real
    assert clock[0] < 1000
    assert board.loop.late == 0
    assert board.motor.told.count(0.0) == 2, board.motor.told
    assert board.motor.told.count(0.5) > 10, board.motor.told


def attack_a_month_has_more_milliseconds_than_a_small_integer():
    board = driving()
    board.loop.skip(31 * 24 * 3600 * 1000 // STEP_MS)
    assert board.loop.now_ms > 0x7FFFFFFF
    board.step(1)
    assert board.now == 0.0, board.motor.told
    board.step(3, [BEAT, go(0.25)])
    assert board.now == 0.25, board.motor.told
    board.step(SILENT)
    assert board.now == 0.0, board.motor.told


def attack_a_day_of_the_loop_ends_while_the_host_drives():
    """Moments go back then: no command ends early, none lasts longer, no beat is lost."""
    for days in (1, 4, 5, 1175):
        for before in range(0, 24, 3):
            board = driving()
            end = (days << 28) - before * STEP_MS
            board.loop.skip((end - board.loop.now_ms) // STEP_MS)
            board.step(3, [BEAT])
            del board.motor.told[:]
            board.step(5, [BEAT, go(0.25)])
            board.step(1, [BEAT, go(0.5)])
            board.step(5, [BEAT])
            assert 0.0 not in board.motor.told, (days, before, board.motor.told)
            assert board.now == 0.5, (days, before, board.motor.told)
            for _ in range(20):
                board.step(1, [BEAT])
            assert board.now == 0.0, (days, before, board.motor.told)
            assert board.motor.told.count(0.5) <= 16, (days, before, board.motor.told)
            assert board.loop.faults == 0, board.loop.fault


def attack_ten_years_are_a_moment_like_any_other():
    board = driving()
    board.loop.skip(10 * 365 * 24 * 3600 * 1000 // STEP_MS)
    assert board.loop.now_ms > 315000000000
    board.step(1)
    assert board.now == 0.0, board.motor.told
    board.step(3, [BEAT, go(0.25)])
    assert board.now == 0.25, board.motor.told
    board.bumper.hit = True
    board.step(2)
    assert board.now == -0.5, board.motor.told
    board.bumper.hit = False
    board.step(SILENT)
    assert board.now == 0.0, board.motor.told
    assert board.loop.faults == 0, board.loop.fault


def attack_a_reaction_that_blocks_or_raises_stops_the_motor():
    class Sour(Reaction):
        bumper = reads(bool)
        motor = writes(float, priority=20)
        asked = 0

        def react(self, bumper):
            self.asked += 1
            if self.asked > 3:
                raise RuntimeError
            return 0.75

    motor = Motor()
    loop = Loop([Sour()], [Bumper()], [motor], rate=50)
    for _ in range(5):
        loop.step()
    assert motor.told == [0.0, 0.75, 0.75, 0.75, 0.0], motor.told
    clock = [0]
    real = minimal._ticks, minimal._sleep

    def sleep(ms):
        clock[0] += ms

    class Blocks(Sour):
        def react(self, bumper):
            clock[0] += 600
            return 0.75

    motor = Motor()
    minimal._ticks, minimal._sleep = (lambda: clock[0]), sleep
    try:
        loop = Loop([Blocks()], [Bumper()], [motor], rate=50)
        loop.run(5)
    finally:
        minimal._ticks, minimal._sleep = real
    assert motor.told == [0.0] + [0.75] * 5 + [0.0], motor.told
    assert loop.late >= 5 * 28, loop.late


def attack_no_memory_is_a_fault_and_safe():
    class Greedy(Avoid):
        def react(self, bumper):
            if bumper:
                return 0.1 * len([bytearray(1 << 28) for _ in range(64)])
            return 0.5

    class Full(Greedy):
        def react(self, bumper):
            if bumper:
                raise MemoryError
            return 0.5

    import sys

    greedy = Greedy if sys.implementation.name == "micropython" else Full
    bumper, motor = Bumper(), Motor()
    loop = Loop([greedy()], [bumper], [motor], rate=50)
    loop.step()
    bumper.hit = True
    loop.step()
    bumper.hit = False
    loop.step()
    assert motor.told == [0.0, 0.5, 0.0, 0.5], motor.told


def attacks():
    return sorted(name for name in globals() if name.startswith("attack_"))


def attack_readings_that_fit_in_no_message_together_go_one_by_one():
    """Each row has a reading a second: none is lost to another one's size."""
    board, found = readings([Row("left"), Row("right")], 10)
    assert board.loop.faults == board.line.lost == 0, board.loop.fault
    (left, no_left), (right, no_right) = found
    assert 9 <= min(left, right) <= max(left, right) <= 12, found
    assert no_left == no_right == 0, found


def attack_a_reading_that_fits_in_no_message_hides_no_other():
    """It is said to be missing, and why; the others go on."""
    wide = Row("wide")
    wide.count *= 2
    board, found = readings([Row("left"), wide, Row("right")], 10)
    (left, _), (whole, missing), (right, _) = found
    assert min(left, right, missing) >= 9, found
    assert whole == 0, found
    assert board.loop.fault[0] == "link of wide", board.loop.fault


def attack_a_line_that_is_too_slow_is_shared():
    """Rows of each step: more than the line takes, and each gets its turns."""
    rows = [Row("left"), Row("middle"), Row("right")]
    for each in rows:
        each.rate = None
    board, found = readings(rows, 10)
    counts = [count for count, _ in found]
    assert 20 <= min(counts) >= max(counts) - 2, found
    assert board.line.lost == 0


def attack_all_names_that_a_message_takes_are_told():
    names = "bumper,%s;motor"
    name = "x" * (link.LONGEST - 13 - len(names) + 2)
    board = Board(more=[Row(name)])
    board.step(5, [ASK])
    board.step(5)
    found = [each[9:].decode() for each in told(board) if each[0] == 110]
    assert len(found[0]) == link.LONGEST - 13, found
    assert name in found[0], found
    assert board.loop.faults == 0, board.loop.fault


class Hold(Reaction):
    bumper = reads(bool)

    def react(self, bumper):
        return -0.5


def attack_answers_that_fit_in_no_message_together_are_all_given():
    """Twenty reflexes of long names hold a motor each: each command hears of its own."""
    board = Board()
    motors, holds = [board.motor], []
    for i in range(20):
        name = ("x%d" % i) + "y" * 60  # noqa: UP031
        if i:
            motors.append(Motor())
            motors[i].name = name
        motors[i].command_timeout = 1.0
        port = writes(float, name=motors[i].name)
        holds.append(type("Hold", (Hold,), {"motor": port})(name))
    orders = link.from_host(tuple(motors))
    sensors = [board.bumper, link.Host(link.HOST)]
    board.loop = Loop(holds + orders, sensors, motors, rate=1000 // STEP_MS)
    board.link = link.Link(board.loop, orders, "power-on", True, board.line)
    board.step(20, [BEAT])
    told(board)
    commands = [bytes((i,)) + go(0.25)[2:] for i in range(20)]
    board.step(1, [b"w" + b"".join(commands[:8])])
    board.step(1, [b"w" + b"".join(commands[8:16])])
    board.step(1, [b"w" + b"".join(commands[16:])])
    board.step(40)
    answers = b"".join([each for each in told(board) if each[0] == 97])
    assert answers.count(b"y" * 60) == 20, answers
    assert board.loop.faults == board.line.lost == 0, board.loop.fault
