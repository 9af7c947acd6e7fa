"""``esair view``: a robot, live, in Foxglove or Lichtblick; read only."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from esair.cli._errors import CANNOT_USE, tell
from esair.cli._foxglove import Views
from esair.cli._options import Which
from esair.exceptions import EsairError, describe
from esair.seat import Client, connect


def view(*, robot: Which = None, port: int = 8765, origin: Sequence[str] = ()) -> int:
    """Show a robot live to Foxglove or Lichtblick.

    Open a connection to ws://127.0.0.1:8765 there. It can be looked at, and nothing can
    be changed. A recording is opened by these programs as it is.

    Args:
        port: Where it is shown, on this computer alone.
        origin: A page that may look too, such as https://lichtblick.example.org.
    """
    try:
        with connect(robot) as client:
            return asyncio.run(show(client, Views(client.name, origin), port))
    except EsairError:
        raise
    except OSError as error:
        tell(f"--port: {describe(error)}")
        return CANNOT_USE
    except KeyboardInterrupt:
        return 0


async def show(client: Client, views: Views, port: int) -> int:
    """Show what a robot tells, as long as it tells."""
    await views.start(port)
    print(  # noqa: T201 - this is the output
        f"{client.name}: ws://127.0.0.1:{views.port}/ for Foxglove or Lichtblick; "
        "Ctrl-C ends it",
        flush=True,
    )
    loop = asyncio.get_running_loop()
    over: asyncio.Future[int] = loop.create_future()

    def hear() -> None:
        try:
            for found in client.lines(0.0):
                if "message" in found:
                    views.show(**found["message"])
        except EsairError as error:
            loop.remove_reader(client)
            if not over.done():
                over.set_exception(error)

    client.send("view")
    loop.add_reader(client, hear)
    try:
        return await over
    finally:
        loop.remove_reader(client)
        await views.close()
