"""A pump that must not run dry."""

import esair


class Dry(esair.Reaction):
    """The pump runs only while the valve is open, whoever has closed that, and how."""

    is_open = esair.reads(bool, name="valve.applied")
    pump = esair.guards(float)

    def react(self, is_open: bool, pump: float) -> float | None:
        return pump if is_open else None
