"""Where the sockets of robots are: a folder of the user's own, one lock for each name."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import socket
import stat
import tempfile
import time
from pathlib import Path

from esair.exceptions import ConfigError

_PATHS = "/proc/self/fd/{folder}/{name}"
"""A path by the descriptor of its folder: short, and it cannot be led elsewhere."""

LOOKED_AT = 0.1  # How long who only looks for robots may have a lock, in seconds


def folder() -> Path:
    """Return the folder for sockets: of the service, of the session, or of the user."""
    service = os.environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]
    if service:
        return Path(service)
    session = os.environ.get("XDG_RUNTIME_DIR")
    if session:
        return Path(session) / "esair"
    of_user = Path(f"/run/user/{os.getuid()}")
    if os.access(of_user, os.W_OK):
        return of_user / "esair"
    return Path(tempfile.gettempdir()) / f"esair-{os.getuid()}"


def robots() -> dict[str, Path]:
    """Return the sockets of the robots that run on this computer, by name."""
    found: dict[str, Path] = {}
    for place in (folder(), Path("/run/esair")):
        with contextlib.suppress(OSError):
            for path in sorted(place.glob("*.sock")):
                if path.stem not in found and _is_live(path):
                    found[path.stem] = path
    return found


def _is_live(path: Path) -> bool:
    """Tell whether a robot holds the lock of a socket."""
    try:
        with (path.parent / f"{path.stem}.lock").open("rb") as lock:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


class Place:
    """The place of one robot's socket: taken once, given back at its end."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.folder: Path = folder()
        self._folder = _own_folder(self.folder)
        self._lock = -1
        try:
            self._take_lock()
        except BaseException:
            os.close(self._folder)
            raise

    @property
    def path(self) -> Path:
        """Where the socket is."""
        return self.folder / f"{self.name}.sock"

    def _take_lock(self) -> None:
        flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
        self._lock = os.open(
            f"{self.name}.lock", flags, mode=0o600, dir_fd=self._folder
        )
        end = time.monotonic() + LOOKED_AT
        while True:
            with contextlib.suppress(BlockingIOError):
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            if time.monotonic() > end:
                break
            time.sleep(0.001)
        os.close(self._lock)
        told = "a robot of this name runs already: stop it, or name this one else"
        raise ConfigError(f"robot {self.name!r}", "name", told)

    def bind(self) -> socket.socket:
        """Return the socket, not listening yet; one that a dead robot left goes."""
        name = f"{self.name}.sock"
        with contextlib.suppress(FileNotFoundError):
            os.unlink(name, dir_fd=self._folder)
        bound = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            bound.setblocking(False)
            path = _PATHS.format(folder=self._folder, name=name)
            bound.bind(path)
            os.chmod(name, 0o600, dir_fd=self._folder)
        except BaseException:
            bound.close()
            raise
        return bound

    def close(self) -> None:
        """Take the socket away, and let another robot have the name."""
        with contextlib.suppress(OSError):
            os.unlink(f"{self.name}.sock", dir_fd=self._folder)
        # The lock file stays: another robot may wait for this very file.
        os.close(self._lock)
        os.close(self._folder)


def secret_file(name: str, secret: str) -> Path:
    """Write a secret of a robot where only its user can read it."""
    place = folder()
    opened = _own_folder(place)
    try:
        file = f"{name}.token"
        with contextlib.suppress(FileNotFoundError):
            os.unlink(file, dir_fd=opened)
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        with os.fdopen(os.open(file, flags, mode=0o600, dir_fd=opened), "w") as out:
            out.write(secret + "\n")
    finally:
        os.close(opened)
    return place / file


def reach(path: Path) -> socket.socket:
    """Return a connection to a socket, however long its path is."""
    place = os.open(path.parent, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        link.connect(_PATHS.format(folder=place, name=path.name))
    except BaseException:
        link.close()
        raise
    finally:
        os.close(place)
    return link


def _own_folder(place: Path) -> int:
    """Open the folder, made if need be: ours alone, whoever made it."""
    with contextlib.suppress(FileExistsError):
        place.mkdir(mode=0o700, parents=True)
    flags = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
    try:
        opened = os.open(place, flags)
    except OSError as error:
        if error.errno not in {errno.ENOTDIR, errno.ELOOP}:
            raise
        raise _not_ours(place, "it is a link, or no folder") from None
    found = os.fstat(opened)
    if found.st_uid != os.getuid():
        os.close(opened)
        raise _not_ours(place, f"it belongs to user {found.st_uid}")
    if stat.S_IMODE(found.st_mode) & 0o077:
        os.fchmod(opened, 0o700)
    return opened


def _not_ours(place: Path, why: str) -> ConfigError:
    told = f"expected a folder of this user alone, {why}: remove it"
    return ConfigError("control socket", str(place), told)
