"""What the recipes are made of: one command for some seconds, to wheels or to an arm."""

import esair


class Drive(esair.Behavior):
    """Gives the wheels one command for some seconds."""

    wheels = esair.writes(str)

    def __init__(self, command: str, seconds: float = 1.0) -> None:
        super().__init__()
        self.command = command
        self.seconds = seconds

    async def run(self) -> str:
        end = esair.now() + self.seconds
        async for _ in esair.every(0.1):
            if esair.now() >= end:
                break
            await self.wheels.write(self.command)
        return self.command


class Reach(Drive):
    """Gives the arm one command for some seconds."""

    wheels = esair.writes(str, name="arm")


class Fail(Drive):
    """Drives, and finds at the end that it does not work."""

    async def run(self) -> str:
        await super().run()
        raise RuntimeError(f"{self.command} does not work")
