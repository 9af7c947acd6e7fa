"""esair: robot software that must not hurt anyone, lose data or stop by itself.

A robot is made of sensors and actuators (its *resources*) and of behaviors and
reactions (its *actions*). Subclass those, hand them to a `Robot`, and `run` it::

    class Avoid(esair.Reaction):
        sonar = esair.reads(float, max_age=0.5)
        wheels = esair.writes(Twist, priority=10)

        def react(self, sonar: float) -> Twist | None:
            return Twist(0.0, 1.2) if sonar < 0.4 else None

    esair.run(esair.Robot(resources=[Sonar(), Wheels()], behaviors=[Avoid()]))
"""

from __future__ import annotations

__version__ = "0.3.0"

TYPE_CHECKING = False  # as checkers read it: `typing` is not loaded for this
if TYPE_CHECKING:
    from esair._names import *  # noqa: F403
    from esair._names import __all__ as __all__
else:  # not for checkers: they would believe in any name

    def __getattr__(name: str) -> object:
        """Load all public names with the first one that is used.

        So a module of the package that needs none of them, such as `esair.minimal`,
        does not bring them, and who uses one (a base class, say) has all of them
        before the loop begins.
        """
        if not name.startswith("_") or name == "__all__":
            from importlib import import_module, util

            if util.find_spec(f"esair.{name}") is not None:
                return import_module(f"esair.{name}")
            from esair import _names

            names = ("__all__", *_names.__all__)
            globals().update({each: getattr(_names, each) for each in names})
            if name in globals():
                return globals()[name]
        raise AttributeError(f"module 'esair' has no attribute {name!r}")

    def __dir__() -> list[str]:
        return sorted({*globals(), *__getattr__("__all__")})
