"""A behavior that goes on when it cannot read."""

import esair


class Watch(esair.Behavior):
    """Keeps the newest distance, and why there is none."""

    sonar = esair.reads(float, max_age=0.5)

    def __init__(self) -> None:
        super().__init__()
        self.distance: float | None = None
        self.trouble = ""

    async def run(self) -> None:
        async for _ in esair.every(0.1):
            try:
                self.distance = await self.sonar.read(timeout=0.2)
                self.trouble = ""
            except OSError as error:  # whatever the reason: there is no value now
                self.distance = None
                self.trouble = str(error)
