"""The rules of MIN as plain functions, for CPython and for MicroPython."""

# ruff: noqa: PT017
# MicroPython has no pytest.

from collections import namedtuple

from esair import minimal
from esair.minimal import Actuator, Loop, Reaction, Sensor, guards, reads, writes

Scan = namedtuple("Scan", ("first", "ranges"))


class Sonar(Sensor):
    def __init__(self, *values):
        Sensor.__init__(self)
        self.values = list(values)
        self.asked = 0

    def read(self):
        self.asked += 1
        value = self.values[0] if len(self.values) == 1 else self.values.pop(0)
        if isinstance(value, BaseException):
            raise value
        return value


class Motor(Actuator):
    safe = 0.0
    command_timeout = 0.1

    def __init__(self, name="motor"):
        Actuator.__init__(self, name)
        self.told = []
        self.errors = []
        self.state = "new"

    def open(self):
        self.state = "open"

    def close(self):
        self.state = "closed"

    def write(self, command):
        error = self.errors.pop(0) if self.errors else None
        if error is not None:
            raise error
        self.told.append(command)


class Go(Reaction):
    """Says what it reads; negative readings are no opinion."""

    sonar = reads(float)
    motor = writes(float)

    def react(self, sonar):
        return sonar if sonar >= 0 else None


class GoOn(Go):
    """The same while the reading is not older than five steps at 50 Hz."""

    sonar = reads(float, max_age=0.09)
    motor = writes(float)


def told_by(values, steps, reaction=None, motor=None):
    motor = motor or Motor()
    loop = Loop([reaction or Go()], [Sonar(*values)], [motor], rate=50)
    for _ in range(steps):
        loop.step()
    return loop, motor


def rule_names_default_to_the_class_in_snake_case():
    class MyHTTPSonar2Front(Sonar):
        pass

    assert MyHTTPSonar2Front(1).name == "my_http_sonar2_front"
    assert Motor("arm").name == "arm"


def rule_a_part_that_forgets_its_base_class_has_a_name_too():
    class FrontSonar(Sensor):
        def __init__(self):
            pass

        def read(self):
            return 1

    part = FrontSonar()
    Loop([], [part], [])
    assert part.name == "front_sonar", part.name


def rule_the_first_and_the_last_command_is_the_safe_one():
    motor = Motor()
    Loop([Go()], [Sonar(0.5)], [motor], rate=1000).run(steps=2)
    assert motor.told == [0.0, 0.5, 0.5, 0.0]
    assert motor.state == "closed"


def rule_every_exit_ends_with_the_safe_command():
    for error in (KeyboardInterrupt(), SystemExit()):
        motor = Motor()
        loop = Loop([Go()], [Sonar(0.5, 0.5, error)], [motor], rate=1000)
        try:
            loop.run()
        except (KeyboardInterrupt, SystemExit) as caught:
            assert caught is error
        else:
            raise AssertionError
        assert motor.told == [0.0, 0.5, 0.5, 0.0]


def rule_ctrl_c_amid_a_step_of_ones_own_loop_ends_with_the_safe_command():
    for error in (KeyboardInterrupt, SystemExit):
        motor = Motor()
        loop = Loop([Go()], [Sonar(0.5, error(), 0.25)], [motor], rate=1000)
        loop.step()
        try:
            loop.step()
        except error:
            pass
        else:
            raise AssertionError
        assert motor.told == [0.0, 0.5, 0.0], motor.told
        assert motor.state == "closed"
        loop.close()  # which closes nothing a second time
        assert motor.told == [0.0, 0.5, 0.0], motor.told
        loop.step()  # it begins anew
        assert motor.told == [0.0, 0.5, 0.0, 0.0, 0.25], motor.told
        loop.close()


def rule_a_start_that_fails_leaves_nothing_open():
    motors = [Motor("motor"), Motor("other")]
    sonar = Sonar(0.5)
    loop = Loop([Go()], [sonar], motors, rate=1000)
    good = sonar.open

    def bad():
        raise OSError(5)

    sonar.open = bad  # type: ignore[method-assign]
    try:
        loop.step()
    except OSError:
        pass
    else:
        raise AssertionError
    assert [motor.told[-1] for motor in motors] == [0.0, 0.0]
    assert [motor.state for motor in motors] == ["closed", "closed"]
    sonar.open = good  # type: ignore[method-assign]
    loop.step()
    assert motors[0].told[-1] == 0.5
    loop.close()


def rule_ctrl_c_while_it_closes_does_not_cost_the_safe_command():
    motors = [Motor("motor"), Motor("other")]
    motors[0].errors = [None, None, KeyboardInterrupt()]
    try:
        Loop([Go()], [Sonar(0.5)], motors, rate=1000).run(steps=1)
    except KeyboardInterrupt:
        pass
    else:
        raise AssertionError
    assert [motor.told[-1] for motor in motors] == [0.0, 0.0]
    assert [motor.state for motor in motors] == ["closed", "closed"]


def rule_ctrl_c_that_comes_twice_does_not_cost_the_safe_command():
    class Twice:
        def values(self):  # the first lines of `close` ask for them
            loop.outputs = outputs
            raise KeyboardInterrupt

    def feed():
        loop.outputs = Twice()
        raise KeyboardInterrupt

    motor = Motor()
    loop = Loop([Go()], [Sonar(0.5)], [motor], rate=1000)
    outputs = loop.outputs
    try:
        loop.run(feed=feed)
    except KeyboardInterrupt:
        pass
    else:
        raise AssertionError
    assert motor.told == [0.0, 0.5, 0.0], motor.told
    assert motor.state == "closed"


def rule_a_sensor_that_raises_parks_its_readers_and_not_the_loop():
    loop, motor = told_by([0.5] + [OSError(5)] * 3 + [0.25], 5)
    # After three of its periods the reading is too old.
    assert motor.told == [0.0, 0.5, 0.0, 0.25], motor.told
    assert loop.steps == 5
    assert loop.faults == 3
    assert loop.fault[0] == "sonar"


def rule_an_old_reading_is_good_until_its_greatest_age():
    values = [0.5] + [OSError(5)] * 8
    _, motor = told_by(values, 9, GoOn())
    assert motor.told == [0.0, 0.5, 0.0], motor.told  # nothing new: it does not run
    values = [0.5] + [OSError(5)] * 8
    timed = GoOn()
    timed.rate = 50
    _, motor = told_by(values, 9, timed)
    assert motor.told == [0.0] + [0.5] * 5 + [0.0], motor.told


def rule_nobody_wrote_for_the_command_timeout():
    _, motor = told_by([0.5, -1], 10)
    assert motor.told == [0.0, 0.5, 0.0], motor.told


def rule_none_gives_the_actuator_back_at_once():
    class High(Go):
        motor = writes(float, priority=5)

    class Low(Reaction):
        sonar = reads(float)
        motor = writes(float)

        def react(self, sonar):
            return 0.125

    motor = Motor()
    loop = Loop([High(), Low()], [Sonar(0.5, 0.5, -1)], [motor], rate=50)
    for _ in range(3):
        loop.step()
    assert motor.told == [0.0, 0.5, 0.5, 0.125], motor.told
    assert loop.refused == 2


def rule_a_hold_outlives_the_command():
    class Once(Reaction):
        sonar = reads(float)
        motor = writes(float, priority=5, hold=0.19)
        done = False

        def react(self, sonar):
            if sonar == 1.0:
                return 0.5
            return None

    class Low(Reaction):
        rate = 50
        motor = writes(float)

        def react(self):
            return 0.125

    class Slow(Once):
        rate = 5

    motor = Motor()
    loop = Loop([Slow(), Low()], [Sonar(1.0, -1)], [motor], rate=50)
    for _ in range(11):
        loop.step()
    # Held for ten steps; after five without a write it is safe, and held still.
    assert motor.told == [0.0, 0.5, 0.0, 0.125], motor.told


def rule_what_is_no_number_in_the_limits_never_leaves():
    class Limited(Motor):
        limits = (-1.0, 1.0)

    class Straight(Go):
        def react(self, sonar):
            return sonar

    values = [float("nan"), float("inf"), 2.0, "x", 1]
    loop, motor = told_by(values, 5, Straight(), Limited())
    assert motor.told == [0.0, 1.0], motor.told
    assert loop.faults == 4
    Limited.clamp = True
    loop, motor = told_by([2.0], 3, motor=Limited())
    assert motor.told == [0.0, 1.0, 1.0, 1.0], motor.told


def rule_who_wants_what_is_bad_is_blind():
    class Higher(Go):
        motor = writes(float, priority=2)
        answers = iter([0.25, "x", 0.125, 0.25])

        def react(self, sonar):
            return next(self.answers)

    motor = Motor()
    parts = [Go("low"), Higher("high")]
    loop = Loop(parts, [Sonar(0.5, 0.75, 1.0, 0.5)], [motor], rate=50)
    for _ in range(4):
        loop.step()
    assert motor.told == [0.0, 0.25, 0.0, 0.125, 0.25], motor.told
    assert loop.faults == 1
    assert loop.fault[0] == "high"


def rule_tuples_are_looked_through():
    class Pair(Motor):
        safe = (0.0, 0.0)  # type: ignore[assignment]

    class Both(Go):
        def react(self, sonar):
            return (sonar, 1.0)

    loop, motor = told_by([0.5, float("nan"), 0.25], 3, Both(), Pair())
    assert motor.told == [(0.0, 0.0), (0.5, 1.0), (0.25, 1.0)], motor.told
    assert loop.faults == 1


def rule_commands_are_flat():
    """What is in a row within a command nobody has looked at: no NaN hides there."""

    class Pair(Motor):
        safe = ("off", 0.0)  # type: ignore[assignment]

    class Nested(Go):
        def react(self, sonar):
            return ("on", bad if sonar == 0.5 else sonar)

    nan = float("nan")
    for bad in ((nan,), (1.0, nan), [nan], (0.5,), ()):
        loop, motor = told_by([0.5, 0.25], 2, Nested(), Pair())
        assert motor.told == [("off", 0.0), ("on", 0.25)], (bad, motor.told)
        assert loop.faults == 1, bad


def rule_an_actuator_that_raises_gets_its_safe_command_until_it_takes_it():
    motor = Motor()
    motor.errors = [None, None, OSError(5), OSError(5), OSError(5)]
    loop, motor = told_by([0.5], 6, motor=motor)
    # Step 2 fails, its safe command too, and again in step 3; step 4 is good again.
    assert motor.told == [0.0, 0.5, 0.0, 0.5, 0.5, 0.5], motor.told
    assert loop.faults == 3


def rule_a_reaction_that_raises_is_counted_and_made_safe():
    class Bad(Go):
        def react(self, sonar):
            return 1.0 / sonar

    loop, motor = told_by([1.0, 0.0, 0.5], 3, Bad())
    assert motor.told == [0.0, 1.0, 0.0, 2.0], motor.told
    assert loop.faults == 1
    assert loop.fault[0] == "bad"


def rule_several_commands_go_by_name():
    class Two(Reaction):
        sonar = reads(float)
        left = writes(float)
        right = writes(float)

        def react(self, sonar):
            if sonar < 0:
                return {"wrong": 1.0}
            return {"left": sonar, "right": None}

    left, right = Motor("left"), Motor("right")
    loop = Loop([Two()], [Sonar(0.5, -1)], [left, right], rate=50)
    loop.step()
    loop.step()
    assert left.told == [0.0, 0.5, 0.0]
    assert right.told == [0.0]
    assert loop.faults == 1


def rule_several_commands_that_say_nothing_give_everything_back():
    class High(Reaction):
        sonar = reads(float)
        left = writes(float, priority=5)
        right = writes(float, priority=5)

        def react(self, sonar):
            return {"left": sonar, "right": sonar} if sonar > 0 else {}

    class Low(Reaction):
        sonar = reads(float)
        right = writes(float)

        def react(self, sonar):
            return 0.125

    left, right = Motor("left"), Motor("right")
    loop = Loop([High(), Low()], [Sonar(0.5, -1)], [left, right], rate=50)
    loop.step()
    loop.step()
    assert left.told == [0.0, 0.5]
    assert right.told == [0.0, 0.5, 0.125]
    assert loop.faults == 0


def rule_slower_parts_have_their_turns():
    class Seldom(Go):
        rate = 20

    sonar = Sonar(0.5)
    sonar.rate = 25
    motor = Motor()
    loop = Loop([Seldom()], [sonar], [motor], rate=50)
    for _ in range(50):
        loop.step()
    assert sonar.asked == 25
    assert len(motor.told) == 21


def rule_late_steps_are_counted_and_skipped():
    class Slow(Sonar):
        def read(self):
            minimal._sleep(25)
            return 0.5

    fed = []
    loop = Loop([], [Slow(1)], [], rate=100)
    loop.run(steps=4, feed=lambda: fed.append(1))
    assert len(fed) == loop.steps == 4
    assert 6 <= loop.late <= 40, loop.late  # two of each three are skipped


def rule_the_rate_does_not_drift():
    begin = minimal._ticks()
    loop = Loop([], [Sonar(1)], [], rate=300)
    loop.run(steps=151)
    passed = (minimal._ticks() - begin) & 0x3FFFFFFF
    assert 499 <= passed < 2000, passed
    assert loop.now_ms >= 503, loop.now_ms  # whole milliseconds, and none is lost


class Timed(Reaction):
    """Writes down its times."""

    sonar = reads(float)
    motor = writes(float)

    def __init__(self, rate=None):
        Reaction.__init__(self)
        self.rate = rate
        self.times = []

    def react(self, sonar):
        self.times.append((self.now_ms, self.elapsed_ms))


def rule_a_reaction_knows_the_time():
    timed = Timed(10)
    told_by([1], 11, timed)
    assert timed.times == [(0, 0), (100, 100), (200, 100)], timed.times
    late = Timed()
    told_by([OSError(5), OSError(5), 1, OSError(5), 1], 5, late)
    assert late.times == [(40, 0), (80, 40)], late.times


def rule_a_rate_of_once_in_an_hour_is_not_that_of_the_loop():
    timed = Timed(1 / 3600)
    told_by([1], 11, timed)
    assert timed.times == [(0, 0)], timed.times


def rule_a_block_of_ten_minutes_costs_no_sleep():
    """Steps that were missed are skipped, and the next one is a period away."""
    slept = []
    clock = [1000]
    real = minimal._ticks, minimal._sleep

    def sleep(ms):
        slept.append(ms)
        clock[0] += ms

    class Blocks(Sonar):
        def read(self):
            self.asked += 1
            if self.asked == 2:
                clock[0] += 600000
            return 0.5

    minimal._ticks, minimal._sleep = (lambda: clock[0]), sleep
    try:
        loop = Loop([], [Blocks(1)], [], rate=50)
        loop.run(steps=5)
    finally:
        minimal._ticks, minimal._sleep = real
    assert max(slept) <= 20, slept
    assert loop.late == 29999, loop.late
    assert loop.now_ms == 600080, loop.now_ms


def rule_a_sleep_that_lasts_too_long_is_noticed_before_the_next_step():
    """What was seen before it is as old as it is: nobody moves by it once more."""
    clock = [1000]
    moved: list[float] = []
    real = minimal._ticks, minimal._sleep

    def sleep(ms):
        clock[0] += ms + 1000 * (len(moved) == 2)

    class Steady(GoOn):
        rate = 50

    minimal._ticks, minimal._sleep = (lambda: clock[0]), sleep
    try:
        motor = Motor()
        sonar = Sonar(0.5, 0.5, *[OSError(5)] * 9)
        loop = Loop([Steady()], [sonar], [motor], rate=50)
        loop.run(steps=4, feed=lambda: moved.append(motor.told[-1]))
    finally:
        minimal._ticks, minimal._sleep = real
    assert moved == [0.5, 0.5, 0.0, 0.0], moved
    assert loop.late == 50, loop.late


def rule_the_highest_priority_wins_whatever_the_order():
    class Low(Go):
        motor = writes(float, priority=1)

        def react(self, sonar):
            return 0.125

    class High(Go):
        motor = writes(float, priority=2)

        def react(self, sonar):
            return 0.25

    for reactions in ([Low(), High()], [High(), Low()]):
        motor = Motor()
        loop = Loop(reactions, [Sonar(1)], [motor], rate=50)
        for _ in range(3):
            loop.step()
        assert motor.told == [0.0, 0.25, 0.25, 0.25], motor.told
        assert loop.refused == 3, loop.refused


def rule_of_equal_priorities_the_holder_goes_on_then_the_name():
    class Half(Reaction):
        rate = 25
        motor = writes(float)

        def react(self):
            return 0.5

    class Other(Go):
        def react(self, sonar):
            return 0.125 if sonar else None

    for names, first in (("ab", 0.5), ("ba", 0.125)):
        for turned in (False, True):
            motor = Motor()
            reactions = [Half(names[0]), Other(names[1])]
            if turned:
                reactions.reverse()
            loop = Loop(reactions, [Sonar(1)], [motor], rate=50)
            for _ in range(4):
                loop.step()
            assert set(motor.told[1:]) == {first}, motor.told


class Blind(Reaction):
    """Sees only what the other sensor says."""

    eye = reads(float, max_age=0.05)
    motor = writes(float, priority=5)

    def react(self, eye):
        return None


def blind_world(values, reactions, steps):
    motor = Motor()
    eye = Sonar(*values)
    eye.name = "eye"
    loop = Loop(reactions, [Sonar(1), eye], [motor], rate=50)
    for _ in range(steps):
        loop.step()
    return loop, motor


def rule_who_must_see_holds_the_actuator_safe_while_it_is_blind():
    values = [OSError(5), OSError(5), 1, OSError(5)]
    loop, motor = blind_world(values, [Blind(), Go()], 3)
    assert motor.told == [0.0, 1], motor.told
    assert loop.refused == 2, loop.refused
    values = [1] + [OSError(5)] * 9
    _, motor = blind_world(values, [Blind(), Go()], 8)
    assert motor.told == [0.0, 1, 1, 1, 0.0], motor.told  # safe at once


def rule_a_higher_priority_passes_a_blind_one():
    class Above(Go):
        motor = writes(float, priority=6)

    values = [OSError(5)] * 9
    _, motor = blind_world(values, [Blind(), Above()], 3)
    assert motor.told == [0.0, 1, 1, 1], motor.told


def rule_an_opinion_may_be_missing():
    class Opinion(Blind):
        motor = writes(float, priority=5, blind="release")

    values = [OSError(5)] * 9
    _, motor = blind_world(values, [Opinion(), Go()], 3)
    assert motor.told == [0.0, 1, 1, 1], motor.told


def rule_what_is_optional_blinds_nobody():
    class Maybe(Blind):
        eye = reads(float, max_age=0.05, optional=True)
        sonar = reads(float)
        motor = writes(float)

        def react(self, eye, sonar):  # type: ignore[override]
            return 0.25 if eye is None else 0.5

    values = [1] + [OSError(5)] * 9
    _, motor = blind_world(values, [Maybe()], 5)
    assert motor.told == [0.0, 0.5, 0.5, 0.5, 0.25, 0.25], motor.told


class Bumper(Reaction):
    """Lets half pass at 1, nothing at 2, too much at 3, all else whole."""

    eye = reads(float, max_age=0.05)
    motor = guards(float)

    def react(self, eye, motor):
        if eye == 3:
            return motor * 2
        return {1: motor / 2, 2: None}.get(eye, motor)


def rule_every_command_passes_the_guards():
    loop, motor = blind_world([0, 1, 2, 2, 3, 0], [Bumper(), Go()], 6)
    assert motor.told == [0.0, 1, 0.5, 0.0, 1], motor.told
    assert loop.refused == 3, loop.refused
    assert loop.faults == 1, loop.fault  # more than was asked


def rule_what_stands_is_guarded_too_and_only_gets_less():
    class Once(Reaction):
        rate = 1
        motor = writes(float, hold=1.0)

        def react(self):
            return 1.0

    class Long(Motor):
        command_timeout = 1.0

    eye = Sonar(0, 1, 0, 2, 0)
    eye.name = "eye"
    motor = Long()
    loop = Loop([Bumper(), Once()], [eye], [motor], rate=50)
    for _ in range(6):
        loop.step()
    assert motor.told == [0.0, 1.0, 0.5, 0.0], motor.told


def rule_nothing_passes_a_blind_guard_but_what_it_says():
    class Creeps(Bumper):
        def blind(self, motor):
            return 0.125

    for guard, expected in ((Bumper(), [0.0]), (Creeps(), [0.0, 0.125, 0.125])):
        values = [OSError(5)] * 9
        _, motor = blind_world(values, [guard, Go()], 2)
        assert motor.told == expected, motor.told


def rule_a_guard_that_latches_waits_for_the_user():
    class Latches(Bumper):
        motor = guards(float, latch=True)

    loop, motor = blind_world([0, 2, 0], [Latches("guard"), Go()], 4)
    assert motor.told == [0.0, 1, 0.0], motor.told
    assert loop.reset("guard")
    loop.step()
    assert motor.told == [0.0, 1, 0.0, 1], motor.told


def rule_what_was_blind_between_two_steps_has_been_safe():
    """Its reading was too old before the next one came, and it decides at its rate."""

    class Slow(Reaction):
        rate = 5
        eye = reads(float, max_age=0.05)
        motor = writes(float, hold=1.0)

        def react(self, eye):
            return 1.0

    class Long(Motor):
        command_timeout = 1.0

    for lost, expected in ((1, [0.0, 1.0]), (2, [0.0, 1.0, 0.0])):
        eye = Sonar(*[1] + [OSError(5)] * lost + [1])
        eye.name = "eye"
        motor = Long()
        loop = Loop([Slow()], [eye], [motor], rate=50)
        for _ in range(6):
            loop.step()
        assert motor.told == expected, motor.told


def rule_a_reading_as_old_as_its_greatest_age_is_good():
    """Older is too old: the age of the one is its greatest, that of the other over it."""
    for age, expected in ((0.04, [0.0, 1]), (0.039, [0.0, 1, 0.0])):

        class Exact(Go):
            sonar = reads(float, max_age=age)
            motor = writes(float)

        _, motor = told_by([1, OSError(5), OSError(5)], 3, Exact())
        assert motor.told == expected, motor.told


def rule_a_hold_that_is_over_prefers_nobody():
    """Of equal priorities the present holder goes on; after its hold, the name."""

    class Half(Reaction):
        rate = 10
        motor = writes(float, hold=0.05)

        def react(self):
            return 0.5

    class Late(Half):
        started = False

        def react(self):
            started, self.started = self.started, True
            return 0.125 if started else None

    motor = Motor()
    loop = Loop([Half("b"), Late("a")], [], [motor], rate=50)
    for _ in range(6):
        loop.step()
    assert motor.told[-1] == 0.125, motor.told


def rule_one_port_says_nothing_in_a_dictionary_too():
    class Several(Go):
        def react(self, sonar):
            return {"motor": sonar if sonar > 0 else None}

    class Low(Reaction):
        rate = 50
        motor = writes(float, priority=-1)

        def react(self):
            return 0.125

    motor = Motor()
    loop = Loop([Several(), Low()], [Sonar(0.5, -1)], [motor], rate=50)
    for _ in range(2):
        loop.step()
    assert motor.told == [0.0, 0.5, 0.125], motor.told
    assert loop.faults == 0, loop.fault


def rule_what_a_guard_says_is_a_command_too():
    """Of the type of the actuator: what is none stops all."""

    class Says(Bumper):
        answer = True

        def react(self, eye, motor):
            return self.answer

    class Two(Motor):
        safe = (0.0, 0.0)  # type: ignore[assignment]

    class Both(Go):
        def react(self, sonar):
            return (1.0, 1.0)

    for answer, expected in ((True, [0.0]), (0, [0.0, 0.0]), (0.5, [0.0, 0.5])):
        guard = Says()
        guard.answer = answer  # type: ignore[assignment]
        _, motor = blind_world([0], [guard, Go()], 1)
        assert motor.told == expected, motor.told
        assert type(motor.told[-1]) is float
    guard.answer = [0.0, 0.0]  # type: ignore[assignment]
    motor, eye = Two(), Sonar(0)
    eye.name = "eye"
    loop = Loop([guard, Both()], [Sonar(1), eye], [motor], rate=50)
    loop.step()
    assert motor.told == [(0.0, 0.0)], motor.told


def rule_each_part_of_what_stands_only_gets_less():
    class Once(Reaction):
        rate = 1
        motor = writes(tuple, hold=1.0)

        def react(self):
            return (1.0, -1.0)

    class Parts(Reaction):
        eye = reads(float)
        motor = guards(tuple)

        def react(self, eye, motor):
            return (0.5, -0.5) if eye == 0 else (0.25, -1.0)

    class Pair(Motor):
        safe = (0.0, 0.0)  # type: ignore[assignment]
        command_timeout = 1.0

    eye, motor = Sonar(0, 1), Pair()
    eye.name = "eye"
    loop = Loop([Parts(), Once()], [eye], [motor], rate=50)
    for _ in range(3):
        loop.step()
    assert motor.told == [(0.0, 0.0), (0.5, -0.5), (0.25, -0.5)], motor.told


def rule_a_guard_does_not_latch_at_what_has_ended_at_that_moment():
    class Latches(Bumper):
        motor = guards(float, latch=True)
        eye = reads(float, max_age=1.0)

    class Seldom(Reaction):
        rate = 5
        motor = writes(float)

        def react(self):
            return 1.0

    eye, motor, guard = Sonar(0, 2, 0), Motor(), Latches()
    eye.name, eye.rate = "eye", 10
    loop = Loop([guard, Seldom()], [eye], [motor], rate=50)
    for _ in range(11):
        loop.step()
    assert motor.told == [0.0, 1.0, 0.0, 1.0], motor.told  # its timeout is 0.1 s


def rule_a_latching_guard_waits_for_its_first_sight():
    """What was never moving has not been moved blindly."""

    class Latches(Bumper):
        motor = guards(float, latch=True)

        def blind(self, motor):
            return motor  # nothing passes while it is blind: it latches

    values = [OSError(5), 0, OSError(5)]
    _, motor = blind_world(values, [Latches(), Go()], 6)
    assert motor.told == [0.0, 1, 1, 1, 0.0], motor.told


def rule_a_latching_guard_that_is_blind_while_safe_is_written_waits():
    """A writer that writes what is safe moves nothing."""

    class Latches(Bumper):
        motor = guards(float, latch=True)

    class Later(Reaction):
        rate = 50
        motor = writes(float)

        def react(self):
            return 1.0 if self.now_ms >= 100 else 0.0

    values = [0] + [OSError(5)] * 4 + [0]
    _, motor = blind_world(values, [Latches(), Later()], 9)
    assert 1.0 in motor.told, motor.told


def rule_a_reading_that_is_no_number_never_reaches_a_reaction():
    """NaN is not less than anything: a reaction would take it for "nothing is near"."""

    class Away(Reaction):
        sonar = reads(None)
        motor = writes(float)
        seen: tuple = ()

        def react(self, sonar):
            self.seen += (sonar,)
            return 0.5

    nan, inf = float("nan"), float("inf")
    values = [0.25, nan, inf, -inf, (0.5, nan), [nan, 0.5]]
    away = Away()
    loop, motor = told_by(values, 6, away)
    assert away.seen == (0.25,), away.seen
    assert motor.told == [0.0, 0.5, 0.0], motor.told  # too old after three periods
    assert loop.faults == 5
    assert loop.fault[0] == "sonar"


def rule_infinity_in_a_row_is_nothing_in_reach():
    row = [0.5, float("inf")]

    class Scan(Go):
        def react(self, sonar):
            return min(sonar)

    loop, motor = told_by([row], 2, Scan())
    assert motor.told == [0.0, 0.5, 0.5], motor.told
    sonar = Sonar(row)
    motor = Motor()
    loop = Loop([Scan()], [sonar], [motor], rate=50)
    loop.step()
    row[0] = float("nan")  # the same list, filled anew
    loop.step()
    assert loop.faults == 1, loop.fault


def rule_a_row_in_a_reading_is_looked_at_too():
    seen = []

    class Away(Go):
        def react(self, sonar):
            seen.append(sonar)

    nan, inf = float("nan"), float("inf")
    far = [Scan(0.5, (1.0, inf)), [[0.5, inf], [inf, 0.5]]]
    bad = [Scan(0.5, (nan, 1.0)), Scan(inf, (1.0, 1.0)), [[0.5, 1.0], [nan, 0.5]]]
    loop, _ = told_by(far[:1] + bad + far[1:], 5, Away())
    assert seen == far, seen
    assert loop.faults == 3, loop.fault


def rule_a_number_is_no_dictionary_of_commands():
    for wrong in (0.0, False, "", ()):

        class Two(Reaction):
            sonar = reads(float)
            left = writes(float)
            right = writes(float)
            answer = wrong

            def react(self, sonar):
                return {"left": 0.5, "right": 0.5} if sonar else self.answer

        left, right = Motor("left"), Motor("right")
        loop = Loop([Two()], [Sonar(1, 0)], [left, right], rate=50)
        loop.step()
        loop.step()
        assert left.told == right.told == [0.0, 0.5, 0.0], (wrong, left.told)
        assert loop.faults == 1, (wrong, loop.fault)


def rule_a_latching_guard_that_raises_has_stopped_all():
    class Latches(Bumper):
        motor = guards(float, latch=True)

        def react(self, eye, motor):
            return motor / eye

    loop, motor = blind_world([1, 0, 1], [Latches("guard"), Go()], 4)
    assert motor.told == [0.0, 1, 0.0], motor.told
    assert loop.reset("guard")


def rule_guards_that_lose_sight_together_latch_each():
    """As it is in STD: one after the other, in the order in which they are listed."""

    class Latches(Bumper):
        motor = guards(float, latch=True)

    class Stops(Bumper):
        motor = guards(float, priority=5)

    class On(Go):
        motor = writes(float, hold=1.0)

    class Long(Motor):
        command_timeout = 1.0

    eye, motor, latches = Sonar(0, *[OSError(5)] * 6 + [0]), Long(), Latches()
    eye.name = "eye"
    loop = Loop([latches, Stops(), On()], [Sonar(1), eye], [motor], rate=50)
    for _ in range(9):
        loop.step()
    assert motor.told == [0.0, 1, 1, 1, 0.0], motor.told
    assert loop.reset("latches")


def rule_a_reaction_that_is_blind_keeps_no_latch_open():
    """It stops what moves at the moment at which the guard sees no more; as in STD."""

    class Latches(Bumper):
        motor = guards(float, latch=True)

    class Bars(Reaction):
        eye = reads(float, max_age=0.05)
        motor = writes(float, priority=5)

        def react(self, eye):
            pass

    values = [0] + [OSError(5)] * 6 + [0]
    reactions = [Latches("latches"), Bars(), Go()]
    loop, motor = blind_world(values, reactions, 9)
    assert motor.told == [0.0, 1, 1, 1, 0.0], motor.told
    assert loop.reset("latches")


def rule_a_guard_that_refuses_keeps_no_latch_open():
    class Latches(Bumper):
        motor = guards(float, latch=True)

        def react(self, eye, motor):
            return motor if eye else None

    class Stops(Latches):
        motor = guards(float, priority=5)

    loop, motor = blind_world([1, 0, 1, 1], [Latches("guard"), Stops("stops"), Go()], 5)
    assert motor.told == [0.0, 1, 0.0], motor.told
    assert loop.reset("guard")


def rule_a_guard_latches_at_nothing_that_it_has_made_safe():
    class Latches(Bumper):
        motor = guards(float, latch=True)

        def react(self, eye, motor):
            return (motor, 0.0, None)[eye]

    class Now(Go):
        rate = 25

    _, motor = blind_world([1, 2, 0], [Latches("guard"), Now()], 3)
    assert motor.told == [0.0, 0.0, 1], motor.told


def rule_a_guard_is_not_asked_because_somebody_else_is_blind():
    class Counts(Reaction):
        rate = 1
        motor = guards(float)
        asked = 0

        def react(self, motor):
            self.asked += 1
            return motor

    class Above(Reaction):
        rate = 1
        motor = writes(float, priority=9, hold=1.0)

        def react(self):
            return 1.0

    class Long(Motor):
        command_timeout = 1.0

    eye, motor, guard = Sonar(1, *[OSError(5)] * 9), Long(), Counts()
    eye.name = "eye"
    loop = Loop([guard, Above(), Blind()], [eye], [motor], rate=50)
    for _ in range(9):
        loop.step()
    assert motor.told == [0.0, 1.0], motor.told
    assert guard.asked == 1, guard.asked


def rule_nothing_moves_before_it_is_armed():
    motor = Motor()
    loop = Loop([Go()], [Sonar(1)], [motor], rate=50, armed=False)
    loop.step()
    loop.step()
    assert motor.told == [0.0], motor.told
    loop.arm()
    loop.step()
    assert motor.told == [0.0, 1], motor.told
    loop.arm(False)
    loop.step()
    assert motor.told == [0.0, 1, 0.0], motor.told


def rule_a_reading_has_its_name_and_a_parameter_its_default():
    class Gain(Reaction):
        sonar = reads(float)
        eye = reads(float)
        motor = writes(float)

        def react(self, eye, sonar, gain=2.0):
            return sonar * gain + eye * 100

    _, motor = blind_world([3], [Gain()], 1)
    assert motor.told == [0.0, 302.0], motor.told


def rule_a_plain_function_decides():
    plain = Go("plain")

    def react(sonar, gain=2.0):
        return sonar * gain

    plain.react = react  # type: ignore[method-assign]
    _, motor = told_by([0.5], 1, plain)
    assert motor.told == [0.0, 1.0], motor.told


def rule_readings_may_come_together():
    class All(Go):
        def react(self, **readings):  # type: ignore[override]
            return readings["sonar"]

    _, motor = told_by([0.5], 2, All())
    assert motor.told == [0.0, 0.5, 0.5], motor.told


class Aged(Reaction):
    """Writes down its times, and commands by them."""

    sonar = reads(float, max_age=0.5)
    motor = writes(float, hold=0.1)
    rate = 25

    def __init__(self):
        super().__init__()
        self.times = []

    def react(self, sonar):
        self.times.append((self.now_ms, self.elapsed_ms))
        return 0.5 if (self.now_ms - self.base) // 100 % 3 else None


class AgedGuard(Reaction):
    """Lets less pass by the time, and writes that down too."""

    motor = guards(float)

    def __init__(self):
        super().__init__()
        self.times = []

    def react(self, motor):
        self.times.append((self.now_ms, self.elapsed_ms))
        return motor if self.elapsed_ms < 100 else 0.0


def of_age(first, guarded):
    """Return what a robot does in 2 s from a moment on, and its times since."""
    motor, aged, guard = Motor(), Aged(), AgedGuard()
    sonar = Sonar(*([1.0] * 21 + [OSError(5)] * 40 + [1.0] * 50))
    loop = Loop([aged] + [guard] * guarded, [sonar], [motor], rate=50)
    loop.open()
    loop.say = str
    loop.skip(first // 200 * 10)
    aged.base = base = loop.now_ms
    moments = []
    for _ in range(110):
        loop.step()
        moments.append((len(motor.told), loop.now_ms - base, loop.steps))
    assert loop.late == first // 200 * 10
    times = [(now - base, elapsed) for now, elapsed in aged.times + guard.times]
    return motor.told, moments, times, loop.refused, loop.faults


def rule_a_loop_of_any_age_decides_the_same():
    for guarded in (False, True):
        young = of_age(1000, guarded)
        assert young[0].count(0.5) > 10, young[0]
        assert young[3] + young[4] > 0
        for days in (1, 4, 1175):  # 3 and 12 days, 10 years
            told = of_age((days << 28) - 1000, guarded)
            assert told == young, (days, guarded, told, young)


def rule_a_loop_runs_again():
    values = [0.5, KeyboardInterrupt(), OSError(5), 0.25, 0.25]
    motor = Motor()
    loop = Loop([Go()], [Sonar(*values)], [motor], rate=1000)
    try:
        loop.run()
    except KeyboardInterrupt:
        assert motor.told == [0.0, 0.5, 0.0], motor.told
    del motor.told[:]
    loop.run(steps=2)  # what was asked before counts no more
    assert motor.told == [0.0, 0.25, 0.0], motor.told
    assert loop.steps == 3, loop.steps


def rule_a_step_may_be_kept_from_the_beginning():
    motor = Motor()
    loop = Loop([Go()], [Sonar(0.5)], [motor], rate=50)
    step = loop.step
    step()
    step()
    assert motor.told == [0.0, 0.5, 0.5], motor.told
    loop.close()
    step()
    assert motor.told == [0.0, 0.5, 0.5, 0.0, 0.0, 0.5], motor.told
    loop.close()
    loop.close()


def rule_a_wrong_wiring_is_told():
    for wrong in (Go(), Blind()):
        try:
            Loop([wrong], [], [Motor()])
        except KeyError as error:
            assert error.args[0] in ("sonar", "eye"), error
        else:
            raise AssertionError


def rule_nothing_is_allocated_in_the_steady_state():
    import gc

    if not hasattr(gc, "mem_alloc"):
        return

    class Both(Reaction):
        sonar = reads(float)
        left = writes(float)
        right = writes(float)
        commands = {"left": 0.5, "right": 0.25}  # noqa: RUF012

        def react(self, sonar):
            return self.commands

    motors = [Quiet("left"), Quiet("right")]
    several = Loop([Both()], [Sonar(0.5)], motors, rate=50)
    nothing = told_by([-1], 1, motor=Quiet())[0]
    other = Loop([Go()], [Turns(1)], [Switch("motor")], rate=50)
    for loop in (told_by([0.5], 1, motor=Quiet())[0], other, several, nothing):
        allocates_nothing(loop.step)


class Turns(Sonar):
    name = "sonar"

    def read(self):
        self.asked = 1 - self.asked
        return self.asked


def allocates_nothing(step):
    import gc

    for _ in range(100):
        step()
    gc.collect()
    before = gc.mem_alloc()
    for _ in range(1000):
        step()
    assert gc.mem_alloc() - before == 0, gc.mem_alloc() - before


class Quiet(Motor):
    def write(self, command):
        pass


class Switch(Quiet):
    safe = 0


def rules():
    return sorted(name for name in globals() if name.startswith("rule_"))
