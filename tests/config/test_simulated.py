"""One file serves the real robot and the simulated one."""

from esair import config


def test_sim_tables_count_only_in_the_simulation(project) -> None:
    """Without simulated=True they are ignored."""
    described = config.load(project.write())

    assert type(described.resources["sonar"]).__name__ == "Sonar"
    assert described.buses["front"].port == "/dev/serial/by-id/front"


def test_sim_tables_replace_single_keys(project) -> None:
    """What they do not name stays as it is."""
    bus = config.load(project.write(), simulated=True).buses["front"]

    assert (bus.port, bus.baudrate) == ("memory", 115200)


def test_another_driver_inherits_the_keys_that_it_accepts(project) -> None:
    """The rate counts for the simulated sonar too."""
    sonar = config.load(project.write(), simulated=True).resources["sonar"]

    assert type(sonar).__name__ == "FakeSonar"
    assert (sonar.value, sonar.rate) == (2.5, 20.0)


def test_another_driver_is_not_put_on_the_real_bus(project) -> None:
    """A simulated device opens no bus that it does not ask for."""
    described = config.load(project.write(), simulated=True)

    assert described.resources["sonar"].bus is None
    assert described.resources["wheels"].bus is described.buses["front"]


def test_keys_that_another_driver_does_not_know_are_left_out(project) -> None:
    """The gain of the real sonar is no mistake of the simulated one."""
    path = project.changed("rate = 20", "rate = 20\ngain = 5")

    described = config.load(path, simulated=True)
    assert not hasattr(described.resources["sonar"], "gain")


def test_a_device_without_sim_is_refused_in_the_simulation(project) -> None:
    """A simulation never opens something real by an omission."""
    project.changed('sim = {{ driver = "{m}:FakeSonar", value = 2.5 }}', "")
    path = project.changed('sim = {{ port = "memory" }}', "")
    config.load(path)

    assert (
        "nothing stands for this bus" in project.mistakes(simulated=True)["bus.front"]
    )


def test_a_device_on_no_bus_needs_a_sim_table_too(project) -> None:
    """An empty one says that it is harmless as it is."""
    project.write('[sensor.x]\ndriver = "{m}:Sonar"\n')
    assert "nothing stands for this" in project.mistakes(simulated=True)["sensor.x"]

    path = project.write('[sensor.x]\ndriver = "{m}:Sonar"\nsim = {{}}\n')
    assert list(config.load(path, simulated=True).resources) == ["x"]


def test_mistakes_in_sim_tables_name_their_key(project) -> None:
    """The path leads to the key in the sim table."""
    project.changed("value = 2.5", "value = true, bus = 1, colour = 3")

    assert project.mistakes(simulated=True).keys() == {
        "sensor.sonar.sim.value",
        "sensor.sonar.sim.bus",
        "sensor.sonar.sim.colour",
    }


def test_sim_must_be_a_table_even_when_it_is_not_used(project) -> None:
    """A wrong sim is told when the real robot is loaded."""
    project.changed('sim = {{ port = "memory" }}', "sim = true")

    assert "expected a table" in project.mistakes()["bus.front.sim"]
