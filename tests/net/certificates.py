"""Certificates of robots on this machine, made by openssl."""

from __future__ import annotations

import subprocess
from pathlib import Path

from esair.buses.peer import Tls

CURVE = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes")


def certify(folder: Path) -> None:
    """Make those of one authority, one that is over, and those of another one."""

    def openssl(*arguments: str) -> None:
        done = subprocess.run(
            ["openssl", *arguments], cwd=folder, capture_output=True, check=False
        )
        assert done.returncode == 0, done.stderr

    for authority in ("ca", "other"):
        openssl(
            *("req", "-x509", *CURVE, "-days", "9", "-subj", f"/CN={authority}"),
            *("-keyout", f"{authority}.key", "-out", f"{authority}.pem"),
        )
    (folder / "names").write_text("subjectAltName=IP:127.0.0.1,DNS:localhost\n")
    for name, authority, days in (
        *(("base", "ca", 9), ("rover", "ca", 9), ("thief", "ca", 9)),
        *(("rover", "other", 9), ("rover", "ca", -1)),
    ):
        file = name if authority == "ca" else f"{authority}-{name}"
        file = "expired" if days < 0 else file
        openssl(
            *("req", *CURVE, "-subj", f"/CN={name}"),
            *("-keyout", f"{file}.key", "-out", f"{file}.csr"),
        )
        openssl(
            *("x509", "-req", "-in", f"{file}.csr", "-CA", f"{authority}.pem"),
            *("-CAkey", f"{authority}.key", "-CAcreateserial", "-days", str(days)),
            *("-extfile", "names", "-out", f"{file}.pem"),
        )


def tls(folder: Path, file: str) -> Tls:
    return Tls(folder / "ca.pem", folder / f"{file}.pem", folder / f"{file}.key")
