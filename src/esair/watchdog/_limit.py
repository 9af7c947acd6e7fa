"""How long a robot may stand still, for those who need not load the watchdog."""

LIMIT = 0.25
"""How long the scheduler may stand still while something moves, in seconds."""
