"""Linux's timerfd: from Python's own module, or from the C library before 3.13."""

from __future__ import annotations

import os
import sys

_CLOCK_MONOTONIC = 1
_TFD_FLAGS = os.O_NONBLOCK | getattr(os, "O_CLOEXEC", 0)
_TFD_TIMER_ABSTIME = 1

if sys.version_info >= (3, 13):

    def create() -> int:
        """Return a new descriptor; raise `OSError` if the kernel gives none."""
        return os.timerfd_create(_CLOCK_MONOTONIC, flags=_TFD_FLAGS)

    def settime(fd: int, when: int) -> None:
        """Set a descriptor to a moment of the monotonic clock, in nanoseconds."""
        os.timerfd_settime_ns(fd, flags=_TFD_TIMER_ABSTIME, initial=when)

else:
    import ctypes

    _libc = ctypes.CDLL(None, use_errno=True)
    _Itimerspec = ctypes.c_long * 4  # interval s, ns; value s, ns

    def create() -> int:
        """Return a new descriptor; raise `OSError` if the kernel gives none."""
        fd: int = _libc.timerfd_create(_CLOCK_MONOTONIC, _TFD_FLAGS)
        if fd < 0:
            error = ctypes.get_errno()
            raise OSError(error, os.strerror(error))
        return fd

    def settime(fd: int, when: int) -> None:
        """Set a descriptor to a moment of the monotonic clock, in nanoseconds."""
        seconds, nanoseconds = divmod(when, 1_000_000_000)
        spec = _Itimerspec(0, 0, seconds, nanoseconds)
        _libc.timerfd_settime(fd, _TFD_TIMER_ABSTIME, spec, None)
