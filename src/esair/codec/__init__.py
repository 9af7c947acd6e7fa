"""One coding of plain data: for recordings, child processes and other computers.

Values become tagged bytes and come back equal and of their class. Nothing is imported
or called for it: a class is looked up in a table (`Kinds`) that its user has filled with
what the robot's own ports, drivers and requests declare, and an object is made by its
fields. What cannot cross is an error of its sender that names the field.
"""

from esair.codec._coding import decode, encode
from esair.codec._kinds import LIMIT, CodecError, Kinds, declared, inner_of, kinds_of

__all__ = [
    "LIMIT",
    "CodecError",
    "Kinds",
    "declared",
    "decode",
    "encode",
    "inner_of",
    "kinds_of",
]
