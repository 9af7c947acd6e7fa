"""The page: who may, and what the wheels are told."""

import asyncio
import contextlib
import http.client
import io
import json
import logging
import os
import shutil
import socket
import ssl
import stat
import struct
import subprocess
import sys
import time
import urllib.error
import urllib.request
from typing import Any

import pytest
import websockets
from tests.seat.conftest import STILL, Twist, Wander, eventually, held

import esair
from esair.seat import Seat
from esair.seat._page import CONNECTIONS, OF_ONE

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
    return robot._seat.seat.port


def token_of(robot):
    return robot._seat.seat._page.token


async def get(robot, path="/", *, token=None, **headers):
    """Return the status and the text of an answer."""
    if token is not None:
        headers["Authorization"] = f"Bearer {token}"

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
    """A web socket, as the page opens it; with the right token unless given."""

    def __init__(self, robot, origin=None, token=None):
        self.port = port_of(robot)
        self.origin = f"http://127.0.0.1:{self.port}" if origin is None else origin
        self.token = token_of(robot) if token is None else token
        self.number = 0

    async def __aenter__(self):
        self.link = await websockets.connect(
            f"ws://127.0.0.1:{self.port}/operate",
            origin=self.origin or None,  # type: ignore[arg-type]
        )
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


HALVES = {
    "nothing": b"",
    "half a line": b"GET / HT",
    "half a head": b"GET / HTTP/1.1\r\nX",
}


@pytest.fixture(params=["plain", "tls"])
def way_in(request, tmp_path_factory):
    """How a page is served: in the clear, and by TLS."""
    if request.param == "plain":
        return esair.Page(port=0), None
    file, key = request.getfixturevalue("certificate")
    context = ssl.create_default_context(cafile=str(file))
    context.check_hostname = False
    return esair.Page(port=0, certificate=file, key=key), context


@pytest.mark.promise("SEC-1")
@pytest.mark.fault("H08")
@pytest.mark.parametrize(
    "half",
    [
        "half a head",
        *(
            pytest.param(h, marks=pytest.mark.long)
            for h in HALVES
            if h != "half a head"
        ),
    ],
)
async def test_half_requests_lock_nobody_out(served, way_in, half):
    """Eighty of them, or three hundred: the next one has its answer all the same."""
    page, context = way_in
    async with served(Wander(), page=page) as robot:
        scheme = "http" if context is None else "https"
        address = f"{scheme}://127.0.0.1:{port_of(robot)}/"

        def fetch():
            with urllib.request.urlopen(address, timeout=5, context=context) as found:
                return found.status

        idle = []
        before = len(os.listdir("/proc/self/fd"))
        for many in (80, 220):
            for _ in range(many):
                link = await asyncio.open_connection("127.0.0.1", port_of(robot))
                link[1].write(HALVES[half])
                idle.append(link)
            began = time.monotonic()
            assert await asyncio.to_thread(fetch) == 200
            assert time.monotonic() - began < 2.0
        # Ours, and what the robot still keeps of them.
        assert len(os.listdir("/proc/self/fd")) - before <= len(idle) + OF_ONE + 8
        for reader, writer in idle:  # each is told within two seconds
            with contextlib.suppress(ConnectionError):
                async with asyncio.timeout(4.0):
                    await reader.read()
            writer.close()
        assert OF_ONE < CONNECTIONS < 80
        robot.halt("the test is over")


@pytest.mark.promise("SEC-1")
@pytest.mark.parametrize("asked", ["GET /page.js", "GET /nothing", "POST /"])
async def test_a_connection_has_one_answer(served, asked):
    """Who sends many questions at once has one turn of the robot's loop, not all.

    Also if there is nothing of that name, and with the same words to the browser.
    """
    async with served(Wander()) as robot:
        port = port_of(robot)
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        question = f"{asked} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n"
        writer.write(question.encode() * 100)
        answers = b""
        with contextlib.suppress(ConnectionError):
            while found := await reader.read(65536):
                answers += found
        assert answers.count(b"HTTP/1.1 ") <= 1
        if answers:
            assert b"content-security-policy" in answers.lower()
        writer.close()
        assert (await get(robot, "/page.js"))[0] == 200


@pytest.mark.promise("SEC-1")
async def test_a_browser_on_a_lane_outlives_the_crowd(served):
    """What has shown its token is not sent away for those that have not."""
    async with served(Wander()) as robot, Browser(robot) as browser:
        for _ in range(2):
            idle = [
                await asyncio.open_connection("127.0.0.1", port_of(robot))
                for _ in range(100)
            ]
            assert (await browser.do("status"))["ok"]
            for _, writer in idle:
                writer.close()
        assert (await browser.do("stop"))["ok"]


@pytest.mark.promise("SEC-1")
async def test_lanes_are_for_those_with_the_token(served, monkeypatch):
    """Thirty that say nothing, or something wrong, take none; they are told to go."""
    monkeypatch.setattr("esair.seat._page.LOGIN", 0.5)
    async with served(Wander()) as robot, contextlib.AsyncExitStack() as stack:
        address = f"ws://127.0.0.1:{port_of(robot)}/operate"
        origin: Any = f"http://127.0.0.1:{port_of(robot)}"
        silent = [
            await stack.enter_async_context(websockets.connect(address, origin=origin))
            for _ in range(15)
        ]
        assert robot.journal.counts()["page"]["clients"] == 0
        browsers = [await stack.enter_async_context(Browser(robot)) for _ in range(16)]
        for browser in browsers:
            assert (await browser.do("status"))["ok"]
        for link in silent:
            async with asyncio.timeout(5.0):
                await link.wait_closed()
            assert link.close_code == 4401


@pytest.mark.promise("SEC-1")
async def test_a_flood_of_newcomers_comes_in_one_by_one(served):
    """So many in a second, and as many at once; who is in already has its answers."""
    async with served(Wander()) as robot, Browser(robot) as browser:
        here = ("127.0.0.1", port_of(robot))
        began, flood = time.monotonic(), list[socket.socket]()
        before = robot.journal.counts()["page"]["newcomers"]
        for number in range(300):
            each = socket.socket()
            each.setblocking(False)
            each.connect_ex(here)
            flood.append(each)
            if number % 10 == 9:
                assert (await browser.do("status"))["ok"]
        await asyncio.sleep(0.3)
        came = robot.journal.counts()["page"]["newcomers"] - before
        assert 32 <= came <= 64 * (1.0 + time.monotonic() - began)
        for each in flood:
            each.close()


UPGRADE = """GET /operate HTTP/1.1\r
Host: 127.0.0.1:{port}\r
Origin: http://127.0.0.1:{port}\r
Upgrade: websocket\r
Connection: Upgrade\r
Sec-WebSocket-Version: 13\r
Sec-WebSocket-Key: MDEyMzQ1Njc4OWFiY2RlZg==\r
\r
"""
POST = "POST / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nTransfer-Encoding: chunked\r\n\r\n"
SHOWN = b"\x81\x9e\0\0\0\0" + TOKEN.encode()
FLOODS = {
    "pings": (UPGRADE, b"", b"\x89\x80\0\0\0\0" * 100_000),
    "words": (UPGRADE, b"", b"\x81\x81\0\0\0\0a" * 100_000),
    "words of a guest": (UPGRADE, SHOWN, b"\x81\x81\0\0\0\0a" * 100_000),
    "chunks": (POST, b"", b"1\r\na\r\n" * 100_000),
}


@pytest.mark.promise("SEC-1", "TURN-4")
@pytest.mark.fault("H08")
@pytest.mark.parametrize("flood", FLOODS)
async def test_who_pours_holds_the_loop_for_a_moment(served, flood):
    """Ten thousand of what is smallest at once: it is looked at piece by piece, if at all."""
    first, then, rest = FLOODS[flood]
    async with served(Wander(), page=esair.Page(port=0, token=TOKEN)) as robot:
        link = await asyncio.open_connection("127.0.0.1", port_of(robot))
        reader, writer = link
        async with held() as stretches:
            writer.write(first.format(port=port_of(robot)).encode())
            if first is UPGRADE:
                await reader.readuntil(b"\r\n\r\n")
            writer.write(then)
            await asyncio.sleep(0.1 if then else 0.0)
            writer.write(rest)
            with contextlib.suppress(OSError, TimeoutError):
                async with asyncio.timeout(0.5):
                    while await reader.read(65536):
                        pass
            await asyncio.sleep(0.1)
        writer.close()
        assert max(stretches) < 0.06
        assert (await get(robot))[0] == 200


@pytest.mark.promise("SEC-1")
@pytest.mark.parametrize(
    "garbage",
    [
        pytest.param(b"\x16\x03\x01" + b"x" * 9000, id="one line"),
        pytest.param(b"x\r\n\r\n" * 2000, id="lines"),
    ],
)
async def test_much_garbage_is_one_mistake_of_its_sender(served, garbage):
    """It is told once that it is none of HTTP, and no error of the robot's loop."""
    errors = list[dict[str, Any]]()
    async with served() as robot:
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, told: errors.append(told))
        reader, writer = await asyncio.open_connection("127.0.0.1", port_of(robot))
        writer.write(garbage)
        async with asyncio.timeout(10.0):
            assert (await reader.read()).startswith(b"HTTP/1.1 400 ")
        writer.close()
    assert errors == []


@pytest.mark.promise("OPS-5")
async def test_a_long_line_may_come_with_the_token(served):
    """Who shows the token need not wait for an answer before it asks for more."""
    line = json.dumps({"v": 1, "id": "1", "act": "status", "args": {"x": "y" * 60_000}})
    frame = b"\x81\xfe" + struct.pack(">H", len(line)) + bytes(4) + line.encode()
    async with served(page=esair.Page(port=0, token=TOKEN)) as robot:
        reader, writer = await asyncio.open_connection("127.0.0.1", port_of(robot))
        writer.write(UPGRADE.format(port=port_of(robot)).encode())
        await reader.readuntil(b"\r\n\r\n")
        writer.write(SHOWN + frame)
        async with asyncio.timeout(10.0):
            await reader.readuntil(b'"id":"1"')
        writer.close()


STRANGER = """
import base64, encodings.idna, json, os, socket, struct, sys  # all, while it may
port, path, secret = int(sys.argv[1]), sys.argv[2], sys.argv[3]
os.chdir("/")
os.setgroups([])
os.setgid(65534)
os.setuid(65534)
host = f"127.0.0.1:{port}"

def say(link, text):
    data = text.encode()
    head = struct.pack("!BB", 0x81, 0x80 | len(data)) + bytes(4)
    link.sendall(head + data)

def ask(lines, *told):
    link = socket.create_connection(("127.0.0.1", port), timeout=10)
    link.sendall("\\r\\n".join([*lines, "", ""]).encode())
    found = b""
    try:
        if told:
            found += link.recv(65536)
        for text in told:
            say(link, text)
    except OSError:
        pass
    try:
        while b"\\x11\\x31" not in found and (part := link.recv(65536)):
            found += part
    except OSError:
        pass
    return found

UPGRADE = ["GET /operate HTTP/1.1", f"Host: {host}", f"Origin: http://{host}",
    "Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13",
    "Sec-WebSocket-Key: " + base64.b64encode(os.urandom(16)).decode()]
RESUME = json.dumps({"v": 1, "id": "1", "act": "resume"})
SET = json.dumps({"v": 1, "id": "2", "act": "set", "setting": "wheels.x", "value": 1})
refused = []
for number in range(25):
    link = socket.socket(socket.AF_UNIX)
    try:
        link.connect(path)
        link.sendall((RESUME + "\\n").encode())
        refused.append(link.recv(4096) == b"")
    except PermissionError:
        refused.append(True)
    try:
        open(secret).read()
        refused.append(False)
    except PermissionError:
        refused.append(True)
    wrong = [[RESUME, SET], ["", RESUME], ["x" * 22, RESUME], ["null", SET]][number % 4]
    found = ask(UPGRADE, *wrong)
    refused.append(b"4401" in found or b"\\x11\\x31" in found)
    refused.append(b'"ok"' not in found)
    given = "Authorization: Bearer " + "x" * 22
    found = ask(["GET /metrics HTTP/1.1", f"Host: {host}", given, "Connection: close"])
    refused.append(b" 403 " in found and b"esair_" not in found)
print(json.dumps([refused.count(True), len(refused)]))
"""


@pytest.mark.promise("SEC-1")
async def test_another_user_of_this_computer_is_refused(served, sockets):
    """Socket, token file, page and metrics, 125 of 125; the robot stays halted."""
    if os.getuid() != 0:
        pytest.skip("only root can be somebody else for once")
    async with served(Wander()) as robot:
        robot.halt("the user")
        words = [
            str(port_of(robot)),
            *(str(sockets / f"rover.{k}") for k in ("sock", "token")),
        ]
        asked = await asyncio.create_subprocess_exec(
            sys.executable,
            "-I",
            "-S",
            "-c",
            STRANGER,
            *words,
            stdout=subprocess.PIPE,
        )
        out, _ = await asyncio.wait_for(asked.communicate(), 60.0)
        assert json.loads(out) == [125, 125]
        assert robot.halted == "the user"
        assert robot.wheels.commands[-1] == STILL


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


@pytest.mark.promise("OPS-5")
@pytest.mark.parametrize(
    ("port", "host", "status"),
    [
        (80, "127.0.0.1", 200),
        (80, "localhost", 200),
        (80, "[::1]", 200),
        (80, "evil.example", 403),
        (443, "127.0.0.1", 403),
    ],
)
async def test_the_usual_port_is_in_no_address(served, port, host, status):
    """A browser leaves it out, of the address and of what it asks for."""
    async with served(Wander()) as robot:
        before, robot._seat.seat._page.port = port_of(robot), port
        with contextlib.closing(
            http.client.HTTPConnection("127.0.0.1", before)
        ) as link:

            def ask():
                link.request(
                    "GET", "/", headers={"Host": host, "Origin": f"http://{host}"}
                )
                return link.getresponse().status

            assert await asyncio.to_thread(ask) == status


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


class Slow(esair.Sensor[float]):
    async def read(self) -> float:
        return 1.0

    @esair.operation
    async def wait(self) -> None:
        await asyncio.sleep(60.0)


@pytest.mark.promise("OPS-1")
async def test_who_waits_for_much_can_look_all_the_same(served):
    """What looks changes nothing, and is not among the acts that are under way."""
    async with served(resources=[Slow()]) as robot, Browser(robot) as browser:
        wait = {"act": "operate", "resource": "slow", "operation": "wait"}
        for number in range(16):
            await browser.link.send(json.dumps({"v": 1, "id": f"w{number}", **wait}))

        assert not (await browser.do("operate", resource="slow", operation="wait"))[
            "ok"
        ]
        assert (await browser.do("status"))["ok"]


@pytest.mark.promise("SEC-1")
def test_another_address_needs_tls_or_a_word():
    """Not by an omission; and the token is never shown."""
    with pytest.raises(esair.ConfigError, match="insecure"):
        esair.Page(host="0.0.0.0")
    with pytest.raises(esair.ConfigError, match="22"):
        esair.Page(token="short")
    with pytest.raises(esair.ConfigError, match="no %"):
        esair.Page(token=f"{TOKEN}%")  # an address would say something else
    assert TOKEN not in repr(esair.Page(token=TOKEN))


async def test_a_host_that_there_is_not_is_told_in_words(served):
    """The errors of names are not those of the kernel: it said "Unknown error -2"."""
    page = esair.Page(host="a..b", insecure=True)
    with pytest.raises(esair.ConfigError, match="not known"):
        async with served(page=page):
            pass


def test_a_missing_package_is_named_before_anything_starts(monkeypatch):
    """They are imported where nothing waits for the loop yet."""
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    with pytest.raises(esair.ConfigError, match=r"pip install 'esair\[page\]'"):
        Seat("rover", socket=False, page=esair.Page())


@pytest.mark.promise("SEC-1")
@pytest.mark.fault("P07")
@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
async def test_each_address_needs_the_token(served, sockets, caplog, host):
    """A wrong one, none, an old one: refused; it is in no line of the log."""
    caplog.set_level(logging.DEBUG)
    page = esair.Page(host=host, port=0, insecure=True)
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
        assert (await get(robot, "/metrics", token=token))[0] == 200
        async with Browser(robot, token=token) as browser:
            await browser.do("stop")
        assert robot.halted
    assert not file.exists()
    async with served(Wander(), page=page) as robot:  # its token is another one
        async with Browser(robot, token=token) as browser:
            with pytest.raises(websockets.ConnectionClosed):
                await browser.do("stop")
        assert robot.halted is None
    ours = [each for each in caplog.records if each.name != "websockets.client"]
    assert ours
    assert not [each for each in ours if token in each.getMessage()]


@pytest.mark.promise("SEC-1", "OPS-5")
@pytest.mark.parametrize("terminal", [True, False])
async def test_a_person_at_the_terminal_gets_the_whole_address(
    served, monkeypatch, caplog, terminal
):
    """One click away there; to the log, and to what is no terminal, it is not said."""
    said = io.StringIO()
    said.isatty = lambda: terminal  # type: ignore[method-assign]
    monkeypatch.setattr(sys, "stderr", said)
    async with served() as robot:
        address = f"http://127.0.0.1:{port_of(robot)}/#{token_of(robot)}"
        assert (address in said.getvalue()) == terminal
        assert token_of(robot) not in caplog.text


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
        _, text, _ = await get(robot, "/metrics", token=token_of(robot))
        assert "esair_halted 0" in text
        assert 'esair_writes{component="wheels"}' in text
        assert (
            'esair_state{component="wander",kind="behavior",state="running"} 1' in text
        )
        names = [line.split()[2] for line in text.splitlines() if line[0] == "#"]
        assert len(names) == len(set(names))


@pytest.fixture(scope="session")
def certificate(tmp_path_factory):
    """A certificate of this computer and its key, if openssl is here."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    folder = tmp_path_factory.mktemp("tls")
    words = "req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=localhost"
    files = ["-keyout", str(folder / "key.pem"), "-out", str(folder / "cert.pem")]
    subprocess.run(["openssl", *words.split(), *files], check=True, capture_output=True)
    return folder / "cert.pem", folder / "key.pem"


@pytest.mark.promise("SEC-1")
async def test_with_a_certificate_nothing_is_said_in_the_clear(served, certificate):
    """The page, the metrics and the web socket are by TLS; plain HTTP has no answer."""
    file, key = certificate
    page = esair.Page(port=0, certificate=file, key=key)
    context = ssl.create_default_context(cafile=str(file))
    context.check_hostname = False
    async with served(Wander(), page=page) as robot:
        host = f"127.0.0.1:{port_of(robot)}"

        def fetch(address):
            bearer = {"Authorization": f"Bearer {token_of(robot)}"}
            address = urllib.request.Request(address, headers=bearer)
            with urllib.request.urlopen(address, timeout=10, context=context) as answer:
                return answer.read().decode()

        assert "<title>" in await asyncio.to_thread(fetch, f"https://{host}/")
        assert "esair_up" in await asyncio.to_thread(fetch, f"https://{host}/metrics")
        with pytest.raises((OSError, http.client.HTTPException)):
            await asyncio.to_thread(fetch, f"http://{host}/")
        options: dict[str, Any] = {"ssl": context, "origin": f"https://{host}"}
        async with websockets.connect(f"wss://{host}/operate", **options) as link:
            await link.send(token_of(robot))
            await link.send('{"v": 1, "id": "1", "act": "stop", "reason": "tls"}')
            assert json.loads(await link.recv())["ok"]
        assert robot.halted == "tls"
        options["origin"] = f"http://{host}"
        with pytest.raises(websockets.InvalidStatus):
            async with websockets.connect(f"wss://{host}/operate", **options):
                pass


# A real browser.


@pytest.fixture(scope="module")
def chromium():
    """A Chromium without a window, if there is one."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="pip install '.[ci]'")
    from selenium.common.exceptions import WebDriverException

    driver, browser = shutil.which("chromedriver"), shutil.which("chromium")
    if driver is None or browser is None:
        pytest.skip("chromium and chromium-driver are not installed")
    options = webdriver.ChromeOptions()
    options.binary_location = browser
    for each in ("--headless=new", "--no-sandbox", "--window-size=1000,1100"):
        options.add_argument(each)
    service = webdriver.ChromeService(executable_path=driver)
    found = webdriver.Chrome(options=options, service=service, keep_alive=False)
    found.service.process.stdin.close()  # else it is a descriptor left behind
    try:
        found.get("data:text/html,<h1>it works</h1>")
        assert found.find_element("css selector", "h1").text == "it works"
    except WebDriverException as error:
        found.quit()
        pytest.skip(f"this Chromium and its driver fail at any page: {error.msg}")
    yield found
    found.quit()


LIVE = "return !document.body.classList.contains('silent')"


class Person:
    """Somebody in front of the page; what it does runs in a thread of its own."""

    def __init__(self, chromium, robot):
        self.chromium = chromium
        self.robot = robot

    async def opens(self):
        """Open the page, and wait until it is live."""
        address = f"http://127.0.0.1:{port_of(self.robot)}/#{token_of(self.robot)}"
        await asyncio.to_thread(self.chromium.get, address)
        await self.waits(LIVE)

    async def waits(self, script, *words):
        """Wait until a script returns true."""
        for _ in range(200):
            if await self.runs(script, *words):
                return
            await asyncio.sleep(0.05)
        raise TimeoutError

    async def runs(self, script, *words):
        return await asyncio.to_thread(self.chromium.execute_script, script, *words)

    async def sees_grey(self):
        return "silent" in await self.runs("return document.body.className")

    async def finds(self, selector):
        find = self.chromium.find_element
        return await asyncio.to_thread(find, "css selector", selector)

    async def sees(self, selector):
        """Wait until it is shown."""
        script = (
            "const found = document.querySelector(arguments[0]);"
            "return found !== null && found.checkVisibility();"
        )
        await self.waits(script, selector)

    async def measures(self, selector):
        """Return where it is in the window: left, top, right, bottom."""
        script = (
            "const box = document.querySelector(arguments[0]).getBoundingClientRect();"
            "return [box.left, box.top, box.right, box.bottom];"
        )
        return await self.runs(script, selector)

    async def has_window(self, width, height):
        size = {"width": width, "height": height, "deviceScaleFactor": 1}
        command = self.chromium.execute_cdp_cmd
        override = "Emulation.setDeviceMetricsOverride"
        await asyncio.to_thread(command, override, {**size, "mobile": width < 500})

    async def clicks(self, selector):
        await asyncio.to_thread((await self.finds(selector)).click)

    async def types(self, setting, text):
        """Type the value of a setting, and go on."""
        script = (
            "const named = ([label]) => label.textContent.startsWith(arguments[0]);"
            "const labels = [...document.querySelectorAll('#settings label')];"
            "const input = labels.map((each) => [each, each.querySelector('input')])"
            ".find(named)[1];"
            "input.value = arguments[1]; input.onchange();"
        )
        await self.runs(script, f"{setting} ", text)

    async def key(self, key, *, down):
        from selenium.webdriver.common.action_chains import ActionChains

        chain = ActionChains(self.chromium)
        chain = chain.key_down(key) if down else chain.key_up(key)
        await asyncio.to_thread(chain.perform)

    def holder(self):
        return self.robot.resources.why("wheels").holder

    async def drives(self, press, let_go):
        """Press until it is driving: on a loaded machine what is held may lapse."""
        for _ in range(5):
            await press()
            with contextlib.suppress(TimeoutError):
                await eventually(lambda: self.holder() == "operator", 3.0)
                return
            await let_go()
        raise TimeoutError

    async def holds(self, key):
        """Hold a key until it is driving."""
        await self.drives(
            lambda: self.key(key, down=True), lambda: self.key(key, down=False)
        )


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
    from selenium.webdriver.common.keys import Keys

    robot = served(Wander(), Reads(), resources=[Label()])
    person = Person(chromium, robot)
    async with robot:
        await person.opens()
        await person.clicks("#halt")
        await robot.wheels.until(STILL, timeout=5.0)
        await eventually(lambda: robot.halted == "the page")
        await person.sees("#resume")
        await person.clicks("#resume")
        await robot.wheels.until(Twist(0.3, 0.0), timeout=5.0)

        await person.holds(Keys.ARROW_DOWN)
        driven = Twist(-0.3, 0.0)  # 30 % of an actuator without limits
        await robot.wheels.until(driven, timeout=5.0)
        await asyncio.sleep(1.0)  # longer than a lease: the held key renews it
        assert person.holder() == "operator"
        await person.key(Keys.ARROW_DOWN, down=False)
        await eventually(lambda: person.holder() == "wander")
        assert (await person.finds("#driving")).text == "released"

        # What a device says is text.
        assert await asyncio.to_thread(lambda: chromium.title) == "rover - esair"
        assert "<img" in (await person.finds("#resources")).text
    # The robot has ended: grey within 1 s.
    await asyncio.sleep(1.2)
    assert await person.sees_grey()


class Long(esair.Sensor[str]):
    rate = 20.0
    threshold_of_the_first_derivative_above_which_it_is_told = esair.setting(
        1.0, unit="mg/m^3/s", min=0.0, max=5e12
    )

    def __init__(self) -> None:
        super().__init__(name="l" + 20 * "ong")

    async def read(self) -> str:
        return "w" * 300

    @esair.operation
    async def calibrate_against_the_reference_chamber(self, samples: int) -> str:
        return "done" * samples


SIZES = [(320, 568), (390, 844), (1280, 800)]


@pytest.mark.long
@pytest.mark.promise("OPS-5")
@pytest.mark.parametrize("size", SIZES)
async def test_the_page_fits_where_it_is_looked_at(served, chromium, size):
    """On a phone, too: nothing wider, the pad in sight, STOP and resume to be hit."""
    robot = served(
        Wander(), *(Reads(name=f"r{n}") for n in range(8)), resources=[Long(), Label()]
    )
    person = Person(chromium, robot)
    width, height = size
    await person.has_window(*size)
    async with robot:
        await person.opens()
        await person.sees("#resources tr")
        wide = (
            "return [...document.querySelectorAll('table, section, pre, header, html')]"
            ".filter((each) => each.scrollWidth > Math.max(each.clientWidth, 1)"
            " || each.getBoundingClientRect().right > innerWidth)"
            ".map((each) => `${each.tagName} ${each.id} ${each.scrollWidth}`)"
        )
        assert await person.runs(wide) == []
        left, top, right, bottom = await person.measures("#pad")
        assert left >= 0
        assert right <= width
        assert top >= 0
        assert bottom <= height

        resume = await person.finds("#resume")
        assert not resume.is_displayed()
        robot.halt("because of " + "a very long reason " * 8)
        await person.sees("#resume")
        assert await person.runs(wide) == []
        left, top, right, bottom = await person.measures("#resume")
        assert bottom - top >= 44  # what a thumb hits
        assert right - left >= 88
        # Scrolled it stays on top, to be hit and read.
        await person.runs("window.scrollTo(0, 99999)")
        on_top = (
            "const box = document.querySelector(arguments[0]).getBoundingClientRect();"
            "const [x, y] = [(box.left + box.right) / 2, (box.top + box.bottom) / 2];"
            "return document.elementFromPoint(x, y).id"
        )
        for name in ("halt", "resume", "link"):
            assert await person.runs(on_top, f"#{name}") == name
        await person.clicks("#resume")
        await eventually(lambda: robot.halted is None)
    await person.waits(f"return !(() => {{ {LIVE} }})()")
    for name in ("halt", "link"):
        assert await person.runs(on_top, f"#{name}") == name
    await person.clicks("#halt")
    told = await person.finds("#told")
    await eventually(lambda: "STOP: not sent" in told.text)
    await person.has_window(1000, 1100)


@pytest.mark.long
@pytest.mark.promise("OPS-5")
async def test_what_is_driven_is_no_accident_of_names(served, chromium, fake_actuator):
    """The one that steers; if there are several it is asked, and what is chosen stays."""
    from selenium.webdriver.common.keys import Keys
    from selenium.webdriver.support.ui import Select

    arm = fake_actuator("arm", safe=0.0)
    person = Person(chromium, served(Wander(), resources=[arm]))
    value = "return document.querySelector('#actuator').value"
    async with person.robot:
        await person.opens()
        assert await person.runs(value) == "wheels"
    tracks = fake_actuator("tracks", safe=Twist(0.0, 0.0))
    arm = fake_actuator("arm", safe=0.0)
    person = Person(chromium, served(Wander(), resources=[arm, tracks]))
    async with person.robot as robot:
        await person.opens()
        assert await person.runs(value) == ""
        await person.key(Keys.ARROW_DOWN, down=True)
        driving = await person.finds("#driving")
        await eventually(lambda: driving.text == "choose what to drive first")
        await person.key(Keys.ARROW_DOWN, down=False)
        assert not any(arm.commands)
        button = await person.finds("#pad button")
        assert not button.is_enabled()
        chosen = Select(await person.finds("#actuator"))
        await asyncio.to_thread(chosen.select_by_visible_text, "wheels")
        await robot.resources.remove("tracks")
        await asyncio.sleep(0.6)
        assert await person.runs(value) == "wheels"
        await person.holds(Keys.ARROW_DOWN)
        await person.key(Keys.ARROW_DOWN, down=False)
        assert not any(arm.commands)


@pytest.mark.long
@pytest.mark.promise("SEC-1")
async def test_a_browser_without_the_token_is_asked_for_it(served, chromium):
    """It leaves the address bar; the whole address may be pasted, too."""
    person = Person(chromium, served(Wander()))
    async with person.robot as robot:
        address = f"http://127.0.0.1:{port_of(robot)}/"
        await asyncio.to_thread(chromium.get, address)
        await person.runs("localStorage.clear()")
        await asyncio.to_thread(chromium.get, address)
        await person.sees("#token")
        assert await person.sees_grey()
        field = await person.finds("#token")
        await asyncio.to_thread(field.send_keys, "y" * 22)
        await person.clicks("#login button")
        told = await person.finds("#told")
        await eventually(lambda: "the token is wrong" in told.text)
        await asyncio.to_thread(field.send_keys, f"{address}#{token_of(robot)}")
        await person.clicks("#login button")
        await person.sees("#resources tr")
        assert await asyncio.to_thread(lambda: chromium.current_url) == address
        await person.opens()
        assert await asyncio.to_thread(lambda: chromium.current_url) == address
        login = await person.finds("#login")
        assert not login.is_displayed()


PAD = """
const stick = arguments[0], handle = arguments[1];
const button = (pressed) => ({ pressed });
const buttons = Array.from({ length: 17 }, (_, index) => button(index === 5 && handle));
navigator.getGamepads = () => [null, { connected: true, axes: stick, buttons }];
"""


@pytest.mark.promise("OPS-5", "OPS-4")
async def test_a_gamepad_drives_while_its_handle_is_held(served, chromium):
    """Half a stick is half the speed; without the handle nothing moves."""
    robot = served(Wander())
    person = Person(chromium, robot)
    async with robot:
        await person.opens()
        await person.runs(PAD, [0.0, -1.0], False)
        await asyncio.sleep(0.5)
        assert person.holder() == "wander"

        await person.drives(
            lambda: person.runs(PAD, [0.0, 0.5, 0.0, 0.0], True),
            lambda: person.runs(PAD, [0.0, 0.0], False),
        )
        await robot.wheels.until(Twist(-0.15, 0.0), timeout=5.0)
        await person.runs(PAD, [0.0, 0.5], False)
        await eventually(lambda: person.holder() == "wander")


@pytest.mark.promise("OPS-5", "OPS-4")
async def test_nothing_drives_whose_end_may_not_come(served, chromium):
    """A key with a modifier, and another button of the mouse: by the wheels."""
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.actions.action_builder import ActionBuilder
    from selenium.webdriver.common.actions.mouse_button import MouseButton
    from selenium.webdriver.common.keys import Keys

    robot = served(Wander())
    person = Person(chromium, robot)
    async with robot:
        await person.opens()
        for modifier in (Keys.META, Keys.CONTROL, Keys.ALT):
            for key in (modifier, Keys.ARROW_DOWN):
                await person.key(key, down=True)
            await asyncio.sleep(0.4)
            assert person.holder() == "wander"
            for key in (Keys.ARROW_DOWN, modifier):
                await person.key(key, down=False)
        await person.holds(Keys.ARROW_DOWN)
        await person.key(Keys.META, down=True)
        await eventually(lambda: person.holder() == "wander")
        await asyncio.to_thread(ActionChains(chromium).release().perform)
        await asyncio.to_thread(ActionBuilder(chromium).clear_actions)

        mouse = ActionBuilder(chromium)
        mouse.pointer_action.move_to(await person.finds("#pad button"))
        mouse.pointer_action.pointer_down(MouseButton.RIGHT)
        await asyncio.to_thread(mouse.perform)
        await asyncio.sleep(0.4)
        assert person.holder() == "wander"
        await asyncio.to_thread(ActionBuilder(chromium).clear_actions)


@pytest.mark.promise("OPS-5")
async def test_an_arrow_key_after_the_speed_drives(served, chromium):
    """The slider that a mouse has moved does not keep the keys: no speed grows by them."""
    from selenium.webdriver.common.keys import Keys

    robot = served(Wander())
    person = Person(chromium, robot)
    async with robot:
        await person.opens()
        await person.clicks("#speed")  # its middle: 52 or 53 %
        speed = await person.runs("return document.querySelector('#speed').value")
        await person.holds(Keys.ARROW_UP)
        await robot.wheels.until(Twist(int(speed) / 100, 0.0), timeout=5.0)
        await person.key(Keys.ARROW_UP, down=False)


@pytest.mark.promise("OPS-4", "OPS-5")
async def test_a_menu_of_the_browser_ends_what_is_driven(served, chromium):
    """The key that is let go while it is open is told to the menu, not to the page."""
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    robot = served(Wander())
    person = Person(chromium, robot)
    async with robot:
        await person.opens()
        await person.holds(Keys.ARROW_DOWN)
        await asyncio.to_thread(ActionChains(chromium).context_click().perform)
        await eventually(lambda: person.holder() == "wander")
        await person.key(Keys.ARROW_DOWN, down=False)


@pytest.mark.promise("OPS-5")
async def test_a_finger_that_stays_drives_on(served, chromium):
    """A phone asks for a menu then: the pad has none, and nothing is let go."""
    robot = served(Wander())
    person = Person(chromium, robot)
    async with robot:
        await person.opens()
        left, top, right, bottom = await person.measures("#pad button")
        at = {"x": (left + right) / 2, "y": (top + bottom) / 2}

        def touch(kind, *points):
            how = {"type": kind, "touchPoints": points}
            dispatch = "Input.dispatchTouchEvent"
            return asyncio.to_thread(chromium.execute_cdp_cmd, dispatch, how)

        await person.drives(lambda: touch("touchStart", at), lambda: touch("touchEnd"))
        opens = await person.runs(
            "const asked = new MouseEvent('contextmenu', "
            "{ bubbles: true, cancelable: true });"
            "return document.querySelector('#pad button').dispatchEvent(asked);"
        )
        await asyncio.sleep(0.6)
        assert (opens, person.holder()) == (False, "operator")
        await touch("touchEnd")
        await eventually(lambda: person.holder() == "wander")


@pytest.mark.promise("OPS-4", "OPS-5")
async def test_a_space_stops_as_at_a_terminal(served, chromium):
    """Whoever is frightened hits it while an arrow key is still held."""
    from selenium.webdriver.common.keys import Keys

    robot = served(Wander())
    person = Person(chromium, robot)
    async with robot:
        await person.opens()
        await person.holds(Keys.ARROW_DOWN)
        await person.key(" ", down=True)
        await eventually(lambda: person.holder() == "wander")
        await asyncio.sleep(0.6)
        assert person.holder() == "wander"
        await person.key(" ", down=False)
        await person.key(Keys.ARROW_DOWN, down=False)


LATE = (
    "const take = link.onmessage;"
    "link.onmessage = (found) => setTimeout(() => take(found), arguments[0]);"
)


@pytest.mark.long
@pytest.mark.promise("OPS-5")
async def test_a_picture_that_comes_late_is_not_shown_as_new(served, chromium):
    """A network that is slow has something to say all the time."""
    person = Person(chromium, served(Wander()))
    async with person.robot:
        await person.opens()
        await person.runs(LATE, 1500)
        await person.waits(f"return !(() => {{ {LIVE} }})()")
        for _ in range(10):
            assert await person.sees_grey()
            await asyncio.sleep(0.2)


@pytest.mark.promise("OPS-3", "OPS-5")
async def test_what_comes_too_late_is_not_done(served, chromium):
    """Who has pressed it has given up meanwhile, and may stand in front of it."""
    person = Person(chromium, served(Wander()))
    async with person.robot as robot:
        await person.opens()
        robot.halt("a cat")
        await person.sees("#resume")
        slow = "const send = link.send.bind(link); link.send = (line) => setTimeout("
        await person.runs(
            f"{slow}() => send(line), line.includes('resume') ? 2500 : 0);"
        )
        await person.clicks("#resume")
        told = await person.finds("#told")
        await eventually(lambda: "resume" in told.text, 10.0)
        assert robot.halted == "a cat"


@pytest.mark.promise("OPS-4", "OPS-5")
async def test_another_choice_drives_nothing_of_the_last_one(
    served, chromium, fake_actuator
):
    """Its lease is still on its way when the next key is pressed."""
    tracks = fake_actuator("tracks", safe=Twist(0.0, 0.0))
    person = Person(chromium, served(resources=[tracks]))
    async with person.robot as robot:
        await person.opens()
        await person.runs(LATE, 300)
        await person.runs(
            "for (const name of ['wheels', 'tracks']) {"
            "  byId('actuator').value = name;"
            "  byId('actuator').dispatchEvent(new Event('change'));"
            "  hold([1, 0]);"
            "}"
        )
        await asyncio.sleep(1.5)
        assert set(robot.wheels.commands) == {STILL}


@pytest.mark.long
@pytest.mark.promise("OPS-5")
async def test_it_drives_again_when_the_robot_is_back(served, chromium):
    """A key that was pressed while there was no robot is over, and holds up none."""
    from selenium.webdriver.common.keys import Keys

    person = Person(chromium, served(Wander(), page=esair.Page(port=0, token=TOKEN)))
    async with person.robot as robot:
        await person.opens()
        port = port_of(robot)
        await person.runs("past.set('wheels', [[1e15, {}]])")  # another clock
    await person.waits("return !isConnected()")
    await person.key(Keys.ARROW_DOWN, down=True)
    await person.key(Keys.ARROW_DOWN, down=False)
    again = served(Wander(), page=esair.Page(port=port, token=TOKEN))
    person.robot = again
    async with again:
        await person.waits(LIVE)
        await person.holds(Keys.ARROW_DOWN)
        await again.wheels.until(Twist(-0.3, 0.0), timeout=5.0)
        await person.key(Keys.ARROW_DOWN, down=False)
        assert await person.runs("return past.get('wheels')[0][0] < 1e15")


@pytest.mark.promise("OPS-3", "OPS-5")
async def test_stop_tells_what_has_not_answered(served, chromium):
    """Until the wheels have answered the page does not say that they stand."""
    robot = served(Wander())
    person = Person(chromium, robot)
    async with robot:
        await person.opens()
        robot.wheels.stall()
        await person.clicks("#halt")
        told = await person.finds("#told")
        await eventually(lambda: "STOP is sent, and not answered yet" in told.text)
        await eventually(lambda: told.text.startswith("STOP: wheels: "), 5.0)
        robot.wheels.resume()


class Valve(esair.Sensor[float]):
    rate = 20.0
    flow = esair.setting(1.0, unit="l/min", min=0.0, max=5.0)
    vents = esair.setting(True)
    way = esair.setting("in", choices=["in", "out"])

    def __init__(self) -> None:
        super().__init__(name="valve")
        self.homed: list[tuple[int, float]] = []

    async def read(self) -> float:
        return 1.5

    @esair.operation
    async def home(self, turns: int, speed: float = 0.5, slowly: bool = True) -> str:
        self.homed.append((turns, speed if slowly else -speed))
        return "at home"


@pytest.mark.promise("OPS-5")
async def test_operations_and_settings_in_a_browser(served, chromium):
    """With what they take, their units and limits; by what the device was told."""
    valve = Valve()
    robot = served(Wander(), resources=[valve])
    person = Person(chromium, robot)
    async with robot:
        await person.opens()
        inputs = "#operations form label:nth-of-type(1) input"
        await asyncio.to_thread((await person.finds(inputs)).send_keys, "3")
        await person.clicks("#operations button")
        await eventually(lambda: valve.homed)
        assert valve.homed == [(3, 0.5)]
        output = await person.finds("#operations output")
        await eventually(lambda: output.text == '"at home"')
        await person.key(" ", down=True)  # the button that was pressed keeps no keys
        await person.key(" ", down=False)
        await asyncio.sleep(0.3)
        assert valve.homed == [(3, 0.5)]

        assert "l/min (0 to 5)" in (await person.finds("#settings")).text
        told = (
            "const told = document.getElementById('told').textContent;"
            "return arguments[0] === '' ? told === '' : told.includes(arguments[0])"
        )
        for name, typed, refusal in (
            ("flow", "2.5", ""),
            ("flow", "", "not ''"),  # emptied is not 0
            ("flow", "1,5", "not '1,5'"),
            ("flow", "99", "at most 5"),
            ("vents", "false", ""),
            ("vents", "True", "not 'True'"),
        ):
            await person.types(f"valve.{name}", typed)
            await person.waits(told, refusal)
        assert (valve.flow, valve.vents) == (2.5, False)

        assert "valve.way (in, out)" in (await person.finds("#settings")).text
        await robot.resources.remove("valve")
        await person.waits("return document.querySelector('#settings label') === null")


@pytest.mark.long
@pytest.mark.promise("OPS-5")
async def test_it_is_grey_while_the_loop_is_blocked(served, chromium):
    """Within 1 s; and live again when the loop turns again."""
    robot = served(Wander(), stall_warning=None)
    person = Person(chromium, robot)
    seen: list[tuple[float, bool]] = []

    def looks(until: float) -> None:
        while time.monotonic() < until:
            names = chromium.execute_script("return document.body.className")
            seen.append((time.monotonic(), "silent" in names))

    async with robot:
        await person.opens()
        begin = time.monotonic()
        looking = asyncio.create_task(asyncio.to_thread(looks, begin + 2.4))
        await asyncio.sleep(0.1)
        time.sleep(1.9)  # noqa: ASYNC251 - the loop of the robot stands still
        await looking
        grey = [when - begin for when, is_grey in seen if is_grey]
        assert grey
        assert min(grey) < 1.4
        await person.waits(LIVE)


@pytest.mark.long
@pytest.mark.promise("OPS-5", "OPS-4")
@pytest.mark.fault("H14")
async def test_a_frozen_tab_and_a_killed_one_release_the_wheels(served, chromium):
    """Its lease is not renewed: the wheels are given back within lease + 0.1 s."""
    from selenium.common.exceptions import WebDriverException
    from selenium.webdriver.common.keys import Keys

    robot = served(Wander())
    person = Person(chromium, robot)
    async with robot:
        await person.opens()

        async def presses():
            await person.key(Keys.ARROW_DOWN, down=True)

        async def lets_go():
            await person.key(Keys.ARROW_DOWN, down=False)

        await person.drives(presses, lets_go)
        script = (
            "const end = performance.now() + 2000; while (performance.now() < end);"
        )
        frozen = asyncio.create_task(person.runs(script))
        await eventually(lambda: person.holder() == "wander", 1.5)
        assert not frozen.done()  # it was given back while the tab stood still
        await frozen
        await lets_go()

        await person.drives(presses, lets_go)
        with contextlib.suppress(WebDriverException):
            await asyncio.to_thread(chromium.close)  # its last window: it is gone
        await eventually(lambda: person.holder() == "wander", 1.5)
