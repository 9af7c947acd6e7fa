"""The page: who may, and what the wheels are told."""

import asyncio
import json
import logging
import shutil
import stat
import urllib.error
import urllib.request

import pytest
import websockets
from tests.seat.conftest import STILL, Twist, Wander, eventually

import esair

pytestmark = pytest.mark.real_clock

TOKEN = "x" * 30


@pytest.fixture
def served(rover):
    """Make a robot with a page at a free port."""

    def make(*behaviors, **options):
        options.setdefault("page", esair.Page(port=0))
        return rover(*behaviors, **options)

    return make


def port_of(robot):
    return robot._seat.port


async def get(robot, path="/", **headers):
    """Return the status and the text of an answer."""

    def fetch():
        request = urllib.request.Request(f"http://127.0.0.1:{port_of(robot)}{path}")
        for name, value in headers.items():
            request.add_header(name, value)
        try:
            with urllib.request.urlopen(request, timeout=10) as answer:
                return answer.status, answer.read().decode(), answer.headers
        except urllib.error.HTTPError as error:
            return error.code, "", error.headers

    return await asyncio.to_thread(fetch)


class Browser:
    """A web socket, as the page opens it."""

    def __init__(self, robot, origin=None, token=None):
        self.port = port_of(robot)
        self.origin = f"http://127.0.0.1:{self.port}" if origin is None else origin
        self.token = token
        self.number = 0

    async def __aenter__(self):
        self.link = await websockets.connect(
            f"ws://127.0.0.1:{self.port}/operate",
            origin=self.origin or None,  # type: ignore[arg-type]
        )
        if self.token is not None:
            await self.link.send(self.token)
        return self

    async def __aexit__(self, *_):
        await self.link.close()

    async def do(self, act, **fields):
        self.number += 1
        name = f"b{id(self)}{self.number}"
        await self.link.send(json.dumps({"v": 1, "id": name, "act": act, **fields}))
        while True:
            async with asyncio.timeout(10.0):
                found = json.loads(await self.link.recv())
            if found.get("id") == name and "ok" in found:
                return found


@pytest.mark.promise("OPS-5")
async def test_the_page_needs_nothing_from_elsewhere(served):
    """Three files, no outside address, nothing inline, no markup from outside."""
    async with served() as robot:
        for path in ("/", "/page.js", "/page.css"):
            status, text, headers = await get(robot, path)
            assert status == 200
            assert "http://" not in text
            assert "https://" not in text
            assert "innerHTML" not in text
            assert "default-src 'none'" in headers["content-security-policy"]
        assert (await get(robot, "/../seat.py"))[0] == 404


@pytest.mark.promise("OPS-5", "SEC-1")
async def test_forged_host_and_origin_are_refused(served):
    """Each request: a stranger's name that leads here, a page of somebody else."""
    async with served(Wander()) as robot:
        port = port_of(robot)
        for headers in (
            {"Host": f"evil.example:{port}"},
            {"Host": "127.0.0.1:1"},
            {"Host": f"192.168.1.7:{port}"},
            {"Origin": "http://evil.example"},
            {"Origin": "null"},
        ):
            assert (await get(robot, "/", **headers))[0] == 403
            assert (await get(robot, "/metrics", **headers))[0] == 403
        for origin in ("http://evil.example", "null", f"https://127.0.0.1:{port}", ""):
            with pytest.raises(websockets.InvalidStatus):
                async with Browser(robot, origin):
                    pass
        assert robot.halted is None
        assert robot.journal.counts()["page"]["turned_away"] == 14


@pytest.mark.promise("OPS-5", "OPS-3")
async def test_a_stop_from_the_page_stops_the_wheels(served):
    """The wheels are told safe, and nothing follows until resume."""
    async with served(Wander()) as robot, Browser(robot) as browser:
        await robot.wheels.until(Twist(0.3, 0.0))
        answer = await browser.do("stop", reason="the page")
        assert answer["result"]["told"][0]["answered"]
        assert robot.wheels.commands[-1] == STILL
        count = len(robot.wheels.commands)
        await asyncio.sleep(0.2)
        assert len(robot.wheels.commands) == count
        await browser.do("resume")
        await robot.wheels.until(Twist(0.3, 0.0))


@pytest.mark.promise("OPS-5", "OPS-4")
async def test_a_browser_that_vanishes_releases_the_wheels(served):
    """The same lease as at the terminal."""
    async with served() as robot, Browser(robot) as browser:
        found = (await browser.do("lease", actuator="wheels"))["result"]
        command = {"linear": 0.2, "angular": 0.0}
        await browser.do(
            "drive", lease=found["lease"], beat=found["beat"], command=command
        )
        assert robot.wheels.commands[-1] == Twist(0.2, 0.0)
        browser.link.transport.abort()
        await robot.wheels.until(STILL, timeout=0.6)


@pytest.mark.promise("SEC-1")
def test_another_address_needs_tls_or_a_word():
    """Not by an omission; and the token is never shown."""
    with pytest.raises(esair.ConfigError, match="insecure"):
        esair.Page(host="0.0.0.0")
    with pytest.raises(esair.ConfigError, match="22"):
        esair.Page(token="short")
    assert TOKEN not in repr(esair.Page(token=TOKEN))


@pytest.mark.promise("SEC-1")
@pytest.mark.fault("P07")
async def test_another_address_needs_the_token(served, sockets, caplog):
    """A wrong one, none, an old one: refused; it is in no line of the log."""
    caplog.set_level(logging.DEBUG)
    page = esair.Page(host="0.0.0.0", port=0, insecure=True)
    async with served(Wander(), page=page) as robot:
        file = sockets / "rover.token"
        token = file.read_text().strip()
        assert len(token) >= 22
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
        for wrong in ("y" * 22, "", '{"v":1,"id":"1","act":"stop"}'):
            async with Browser(robot, token=wrong) as browser:
                with pytest.raises(websockets.ConnectionClosed):
                    await browser.do("stop")
        assert robot.halted is None
        assert (await get(robot, "/metrics"))[0] == 403
        good = {"Authorization": f"Bearer {token}"}
        assert (await get(robot, "/metrics", **good))[0] == 200
        async with Browser(robot, token=token) as browser:
            await browser.do("stop")
        assert robot.halted
    assert not file.exists()
    ours = [each for each in caplog.records if each.name != "websockets.client"]
    assert ours
    assert not [each for each in ours if token in each.getMessage()]


@pytest.mark.promise("OPS-5")
async def test_garbage_has_an_answer_here_too(served):
    """The same lines, the same refusals; what is too long ends the connection."""
    async with served() as robot, Browser(robot) as browser:
        await browser.link.send("{")
        assert not json.loads(await browser.link.recv())["ok"]
        assert (await browser.do("status"))["ok"]
        with pytest.raises(websockets.ConnectionClosed):
            await browser.do("x" * (1 << 20))
        assert (await get(robot))[0] == 200


async def test_metrics_for_machines(served):
    """Each counter by component, in the text form of Prometheus."""
    async with served(Wander()) as robot:
        await robot.wheels.until(Twist(0.3, 0.0))
        _, text, _ = await get(robot, "/metrics")
        assert "esair_halted 0" in text
        assert 'esair_writes{component="wheels"}' in text
        assert (
            'esair_state{component="wander",kind="behavior",state="running"} 1' in text
        )
        names = [line.split()[2] for line in text.splitlines() if line[0] == "#"]
        assert len(names) == len(set(names))


# A real browser.


@pytest.fixture
def chromium():
    """A Chromium without a window, if there is one."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not here")
    driver, browser = shutil.which("chromedriver"), shutil.which("chromium")
    if driver is None or browser is None:
        pytest.skip("chromium and chromium-driver are not installed")
    options = webdriver.ChromeOptions()
    options.binary_location = browser
    for each in ("--headless=new", "--no-sandbox", "--window-size=1000,1100"):
        options.add_argument(each)
    service = webdriver.ChromeService(executable_path=driver)
    found = webdriver.Chrome(options=options, service=service)
    yield found
    found.quit()


class Label(esair.Sensor[str]):
    rate = 20.0

    async def read(self) -> str:
        return "<img src=x onerror=document.title='owned'>"


class Reads(esair.Behavior):
    label = esair.reads(str)

    async def run(self) -> None:
        async for _ in self.label:
            pass


@pytest.mark.promise("OPS-5", "SEC-1")
async def test_in_a_browser(served, chromium):
    """STOP, resume, keys, a key that is let go: by what the wheels were told."""
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    def aside(function, *words):
        return asyncio.to_thread(function, *words)

    robot = served(Wander(), Reads(), resources=[Label()])
    async with robot:
        await aside(chromium.get, f"http://127.0.0.1:{port_of(robot)}/")

        async def is_silent():
            classes = await aside(
                chromium.execute_script, "return document.body.className"
            )
            return "silent" in classes

        async def until(condition):
            for _ in range(100):
                if await condition():
                    return
                await asyncio.sleep(0.05)
            raise TimeoutError

        async def is_live():
            return not await is_silent()

        await until(is_live)
        halt = chromium.find_element("id", "halt")
        await aside(halt.click)
        await robot.wheels.until(STILL, timeout=5.0)
        await eventually(lambda: robot.halted == "the page")
        await aside(chromium.find_element("id", "resume").click)
        await robot.wheels.until(Twist(0.3, 0.0), timeout=5.0)

        keys = ActionChains(chromium)
        await aside(keys.key_down(Keys.ARROW_DOWN).perform)
        driven = Twist(-0.3, 0.0)  # 30 % of an actuator without limits
        await eventually(lambda: robot.resources.why("wheels").holder == "operator")
        await robot.wheels.until(driven, timeout=5.0)
        await asyncio.sleep(1.0)  # longer than a lease: the held key renews it
        assert robot.resources.why("wheels").holder == "operator"
        await aside(ActionChains(chromium).key_up(Keys.ARROW_DOWN).perform)
        await eventually(lambda: robot.resources.why("wheels").holder == "wander")

        # What a device says is text.
        assert await aside(lambda: chromium.title) == "rover - esair"
        assert "<img" in await aside(
            lambda: chromium.find_element("id", "resources").text
        )
    # The robot has ended: grey within 1 s.
    await asyncio.sleep(1.2)
    assert await is_silent()
